"""The weights that `body` proposes make the skew that it says."""

import math

import pytest

import rattlesweep as rs
from rattlesweep.analysis.advice import WEIGHT_SHARE, weights_for_skew, with_weights
from rattlesweep.physics.mesh import shapes
from rattlesweep.physics.mesh.printing import write

SIZES = {"length": "12 cm", "width": "3 cm", "height": "12 mm", "mass": "60 g"}


@pytest.mark.parametrize("given", [2.0, -6.0])
def test_two_weights_on_a_half_ellipsoid(given):
    body = rs.Rattleback.half_ellipsoid(**SIZES, skew=math.radians(given))
    advice = weights_for_skew(body)
    assert advice.mass == pytest.approx(WEIGHT_SHARE * 0.06, rel=0.3)
    assert math.degrees(advice.skew) > abs(given) + 1
    x, y = advice.place
    assert (x / 0.06) ** 2 + (y / 0.015) ** 2 < 0.75
    made = rs.Rattleback.half_ellipsoid(
        **SIZES,
        skew=math.radians(given),
        weights=f"{float(advice.mass)!r} kg",
        at=[f"{float(each)!r} m" for each in advice.place],
    )
    assert abs(made.xi) == pytest.approx(advice.skew, rel=1e-9)
    assert made.xi * body.xi > 0


@pytest.mark.parametrize("given", [3.0, -5.0])
def test_two_weights_on_a_mesh(given, tmp_path):
    pytest.importorskip("trimesh")
    path = tmp_path / "stone.stl"
    write(shapes.half_ellipsoid_solid(0.12, 0.03, 0.012, 32, math.radians(given)), path)
    body = rs.Rattleback.from_mesh(path, mass="60 g")
    advice = weights_for_skew(body)
    mass = f"{float(advice.mass)!r} kg"
    points = [(mass, place * 1e3) for place in (advice.place, advice.other)]
    made = rs.Rattleback.from_mesh(path, mass="60 g", points=points)
    # The heavier body is fitted over another part of the twisted bottom.
    assert abs(made.xi) == pytest.approx(advice.skew, rel=6e-3)
    assert made.xi * body.xi > 0
    # On the flat side.
    assert [place[2] for place in (advice.place, advice.other)] == pytest.approx(
        [0, 0], abs=1e-4
    )
    assert "mm of the mesh make it" in advice.sentence


def test_no_weights_where_none_can_lie():
    assert weights_for_skew(rs.Rattleback.gh()) is None
    assert weights_for_skew(rs.Rattleback.kl()) is None


@pytest.mark.parametrize("given", [2.0, -6.0])
def test_the_body_with_two_weights_is_that_made_with_them(given):
    body = rs.Rattleback.half_ellipsoid(**SIZES, skew=math.radians(given))
    advice = weights_for_skew(body)
    found = with_weights(body, advice)
    made = rs.Rattleback.half_ellipsoid(
        **SIZES,
        skew=math.radians(given),
        weights=f"{float(advice.mass)!r} kg",
        at=[f"{float(each)!r} m" for each in advice.place],
    )
    for name in ("alpha", "beta", "gamma", "theta", "phi", "xi", "c", "rim"):
        assert getattr(found, name) == pytest.approx(getattr(made, name), rel=1e-9)
    for name in ("mass", "length", "gravity"):
        wanted = getattr(made.units, name)
        assert getattr(found.units, name) == pytest.approx(wanted, rel=1e-12)
