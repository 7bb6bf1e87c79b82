"""Half ellipsoids against quadrature over their volume, and what is refused of them."""

import math

import numpy as np
import pytest

import rattlesweep as rs
from rattlesweep.physics.shapes import half_ellipsoid

# length, width, height, mass, skew, weights, x, y
STONES = {
    "carved": (0.12, 0.03, 0.012, 0.06, math.radians(3), 0.0, 0.0, 0.0),
    "mirror image": (0.12, 0.03, 0.012, 0.06, math.radians(-3), 0.0, 0.0, 0.0),
    "coins": (0.12, 0.03, 0.012, 0.06, 0.0, 0.0075, 0.045, -0.009),
    "both": (0.2, 0.05, 0.02, 0.2, math.radians(2), 0.01, 0.08, 0.012),
    "short": (0.08, 0.07, 0.02, 0.05, math.radians(20), 0.001, 0.02, -0.02),
    "across": (0.03, 0.12, 0.012, 0.06, 0.05, 0.002, 0.005, -0.04),
}


def integrated(length, width, height, mass, skew, weights, x, y):
    """Parameters from points of mass; axes to the right, towards the observer and down."""
    nodes, shares = np.polynomial.legendre.leggauss(12)
    r, cosine = (nodes + 1) / 2, (nodes + 1) / 2
    turn = 2 * np.pi * np.arange(24) / 24
    r, cosine, turn = (grid.ravel() for grid in np.meshgrid(r, cosine, turn, indexing="ij"))
    sine = np.sqrt(1 - cosine**2)
    points = r * np.array([sine * np.cos(turn), sine * np.sin(turn), cosine])
    points *= np.array([length / 2, width / 2, height])[:, None]
    masses = r**2 * np.einsum("i,j,k->ijk", shares, shares, np.ones(24)).ravel()
    masses *= mass / masses.sum()
    # The inertia of the half ellipsoid is turned clockwise, the weights are not.
    c, s = np.cos(skew), np.sin(skew)
    points = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]) @ points
    points = np.column_stack([points, [x, -y, 0], [-x, y, 0]])
    masses = np.append(masses, [weights, weights])
    total = masses.sum()
    centre = points @ masses / total
    a = height - centre[2]
    points -= centre[:, None]
    tensor = np.eye(3) * (masses * (points**2).sum(axis=0)).sum() - (masses * points) @ points.T
    (smaller, larger), axes = np.linalg.eigh(tensor[:2, :2])
    flatter, bent = sorted([height / (length / 2) ** 2, height / (width / 2) ** 2])
    across = 0.0 if length < width else np.pi / 2
    xi = across - np.arctan2(axes[1, 1], axes[0, 1])
    xi -= np.pi * np.round(xi / np.pi)
    unit = total * a**2
    return {
        "alpha": larger / unit + 1, "beta": smaller / unit + 1, "gamma": tensor[2, 2] / unit,
        "theta": a * bent, "phi": a * flatter, "xi": xi, "c": height / a, "mass": total,
        "height": a,
    }  # fmt: skip


@pytest.mark.parametrize("stone", STONES.values(), ids=STONES.keys())
def test_parameters_are_those_of_quadrature(stone):
    *five, weights, x, y = stone
    found = half_ellipsoid(*five, weights=weights, x=x, y=y)
    assert found.keys() == integrated(*stone).keys()
    for name, value in integrated(*stone).items():
        assert found[name] == pytest.approx(value, rel=1e-9), name


def test_arrays_are_broadcast():
    found = half_ellipsoid([0.12, 0.14], 0.03, 0.012, 0.06, [[0.01], [0.02], [0.03]])
    assert all(values.shape == (3, 2) for values in found.values())
    assert found["xi"][:, 0] == pytest.approx([-0.01, -0.02, -0.03])


def test_words_with_units_are_numbers_in_si_units():
    numbers = {"length": 0.12, "width": 0.03, "height": 0.012, "mass": 0.06, "weights": 0.0075}
    words = {"length": "12 cm", "width": "3cm", "height": "12 mm", "mass": "60 g",
             "weights": "7.5 g"}  # fmt: skip
    body = rs.Rattleback.half_ellipsoid(**numbers, at=(0.045, -0.009))
    for at in ("45, -9 mm", "4.5cm,-9mm"):
        other = rs.Rattleback.half_ellipsoid(**words, at=at)
        for name in ("alpha", "beta", "gamma", "theta", "phi", "xi", "c"):
            assert getattr(other, name) == pytest.approx(getattr(body, name), rel=1e-12)
    assert body.units.mass == pytest.approx(0.075)
    assert body.units.length == pytest.approx(0.0084)


GOOD = {"length": 0.12, "width": 0.03, "height": 0.012, "mass": 0.06, "skew": 0.05}


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"skew": 0.0}, "xi is 0 rad; -pi/2 < xi < 0 is needed, or xi > 0 for a mirror image"),
        ({"height": 0.02}, "theta is 1.11111; 0 < phi < theta < 1 is needed"),
        ({"length": 0.03}, "phi 0.4 is not below theta 0.4; 0 < phi < theta < 1 is needed"),
        ({"mass": -1.0}, "mass is -1; it must be positive"),
        ({"width": "3 kg"}, "width: '3 kg' is a mass; a length is needed, such as 12 mm"),
        ({"weights": 0.01}, "weights and at belong together: the mass of each weight, and the "
         "place (x, y) of one from the middle of the flat side"),
        ({"weights": 0.01, "at": (0.06, 0.01)}, "at: (0.06 m, 0.01 m) is beyond the edge of the "
         "flat side"),
        ({"weights": 0.01, "at": "45 mm"}, "at: '45 mm' has 1 number; 2 are needed, with one unit "
         "behind"),
        ({"weights": 0.01, "at": (1.0,)}, "at: two lengths are needed, and not 1"),
    ],
)  # fmt: skip
def test_what_is_no_body_is_refused_in_a_sentence(change, sentence):
    with pytest.raises(ValueError) as found:  # noqa: PT011 - the sentence is compared
        rs.Rattleback.half_ellipsoid(**{**GOOD, **change})
    assert str(found.value) == sentence
