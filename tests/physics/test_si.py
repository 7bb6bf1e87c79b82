"""Bodies in SI units: their parameters, what is refused, and quantities given as
text.
"""

import json
import math

import numpy as np
import pytest
from sweeping import invoke

import rattlesweep as rs
from rattlesweep.physics.body import PARAMETERS
from rattlesweep.physics.si import components, half_ellipsoid
from rattlesweep.words.units import KINDS, quantity

STONE = {
    "mass": 1.0,
    "inertia": (2e-4, 16e-4, 17e-4, -0.2e-4),
    "height": 0.01,
    "radii": (2.0, 0.045),
}
"""Kane and Levinson's: semi-axes 20, 3, 2 cm; the radii are 20^2/2 and 3^2/2 cm."""
HALF = {
    "length": "12 cm",
    "width": "3 cm",
    "height": "12 mm",
    "mass": "60 g",
    "skew": 0.05,
}


def numbers(body):
    return [getattr(body, name) for name in PARAMETERS]


def test_kane_and_levinsons_body():
    body = rs.Rattleback.from_si(**STONE, c="2 cm")
    expected = [17.00285656, 2.99714344, 17.0, 0.2 / 0.9, 0.005, -0.01428182892]
    assert numbers(body) == pytest.approx(expected, rel=1e-9)
    assert numbers(body) == pytest.approx(numbers(rs.Rattleback.kl()), rel=1e-12)
    assert (body.units.mass, body.units.length, body.c) == (1.0, 0.01, 2)
    assert body.units.time == pytest.approx(math.sqrt(0.01 / 9.81), rel=1e-15)
    assert body.mirrored().units == body.units
    # Comparison ignores the units.
    without = rs.Rattleback(*numbers(body), c=2.0)
    assert (body, repr(body)) == (without, repr(without))
    text = rs.Rattleback.from_si(
        mass="1000 g",
        inertia=STONE["inertia"],
        height="1cm",
        radii=("200 cm", "45 mm"),
        axes_angle="0 deg",
    )
    assert numbers(text) == pytest.approx(numbers(body), rel=1e-14)


@pytest.mark.parametrize("angle", [0.0, 1.5, -2.0])
@pytest.mark.parametrize("order", [1, -1])
def test_any_axes_and_any_order_of_the_radii(angle, order):
    """A body turned about the vertical is the same body."""
    gh = rs.Rattleback.gh()
    mass = 0.2
    a = 0.013
    axes = np.array(
        [[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]]
    )
    plane = axes @ np.diag([gh.alpha - 1, gh.beta - 1]) @ axes.T * mass * a**2
    tensor = np.zeros((3, 3))
    tensor[:2, :2] = plane
    tensor[2, 2] = gh.gamma * mass * a**2
    radii = [a / gh.theta, a / gh.phi]
    direction = angle + gh.xi
    if order < 0:
        radii = radii[::-1]
        direction += math.pi / 2
    stone = {"mass": mass, "height": a, "radii": radii}
    body = rs.Rattleback.from_si(**stone, inertia=tensor, axes_angle=direction)
    assert numbers(body) == pytest.approx(numbers(gh), rel=1e-9)
    # Seen from the other side, the y axis and all angles are reversed.
    flip = np.diag([1, -1, -1])
    seen = rs.Rattleback.from_si(
        **stone, inertia=flip @ tensor @ flip, axes_angle=-direction, z_up=True
    )
    assert numbers(seen) == pytest.approx(numbers(gh), rel=1e-9)


@pytest.mark.parametrize(
    ("make", "wrong", "words"),
    [
        ("from_si", {"mass": 0.0}, "mass is 0; from 1e-09 to 1e.09 kg is allowed"),
        (
            "from_si",
            {"height": "12 kg"},
            "height: '12 kg' is a mass; a length is needed, such as",
        ),
        (
            "from_si",
            {"inertia": (1e-4, 1e-4, 9e-4)},
            "no body has the principal moments 0.0001, 0",
        ),
        (
            "from_si",
            {"inertia": (1e-4, 1e-4, 9e-4)},
            "kg m.2; all must be positive, and none above the sum of the other two",
        ),
        (
            "half_ellipsoid",
            {"skew": "95 deg"},
            "skew is 95 deg; from -89.95 to 89.95 d",
        ),
        ("half_ellipsoid", {"mass": "60 gr"}, "it would be read as a grain"),
        ("from_si", {"inertia": (1, 2)}, "a finite symmetric 3 x 3 matrix is needed"),
        (
            "from_si",
            {"inertia": (2e-4, 16e-4, 17e-4, 0, 1e-5)},
            "is off a principal axis by",
        ),
        (
            "from_si",
            {"inertia": "60,900 g cm^2"},
            "inertia: '60,900 g cm.2' has 2 numbers",
        ),
        (
            "from_si",
            {"radii": (1e300, 0.1)},
            "radii is 1e.300; from 1e-09 to 1e.06 m is allowed",
        ),
        (
            "from_si",
            {"radii": (0.005, 0.1)},
            "radii: 0.005 m is not above the height 0.01 m",
        ),
        (
            "from_si",
            {"c": "2 mm"},
            r"c 0.2 is not above theta 0\.222222: the ellipsoid would",
        ),
        ("half_ellipsoid", {"height": "2 cm"}, "height: the body tips over"),
        ("half_ellipsoid", {"length": 0.12}, "length: 0.12 has no unit, and the body"),
        ("half_ellipsoid", {"mass": "60 kg"}, "the density is 2.653e.06 kg/m.3; from"),
        ("half_ellipsoid", {"wall": "12 mm"}, "wall: 12 mm is not thinner than the s"),
        ("half_ellipsoid", {"weights": "10 g"}, "weights and at belong together"),
        (
            "half_ellipsoid",
            {"weights": "10 g", "at": "6, 1 cm"},
            "beyond the edge of the flat",
        ),
        ("half_ellipsoid", {"weights": "10 g", "at": "45 mm"}, "at: '45 mm' has 1 num"),
    ],
)
def test_impossible_bodies_are_refused(make, wrong, words):
    given = STONE if make == "from_si" else HALF
    with pytest.raises(ValueError, match=words):
        getattr(rs.Rattleback, make)(**(given | wrong))


# length, width, height, mass, skew, weights, x, y
STONES = {
    "mirror image": (0.12, 0.03, 0.012, 0.06, math.radians(-3), 0.0, 0.0, 0.0),
    "coins": (0.12, 0.03, 0.012, 0.06, 0.0, 0.0075, 0.045, -0.009),
    "both": (0.2, 0.05, 0.02, 0.2, math.radians(2), 0.01, 0.08, 0.012),
    "across": (0.03, 0.12, 0.012, 0.06, 0.05, 0.002, 0.005, -0.04),
}


def integrated(length, width, height, mass, skew, weights, x, y, wall=np.inf):
    """Parameters from point masses; axes to the right, towards the viewer and down."""
    nodes, shares = np.polynomial.legendre.leggauss(12)
    cosines, of_cosines = np.polynomial.legendre.leggauss(60)
    turn = 2 * np.pi * np.arange(240) / 240
    r, cosine, turn = np.meshgrid(
        (nodes + 1) / 2, (cosines + 1) / 2, turn, indexing="ij"
    )
    sine = np.sqrt(1 - cosine**2)
    directions = np.stack([sine * np.cos(turn), sine * np.sin(turn), cosine])
    axes = np.array([length / 2, width / 2, height])[:, None, None, None]
    first = np.zeros_like(r)  # where the cavity ends
    if wall < np.inf:
        first = ((directions * axes / (axes - wall)) ** 2).sum(axis=0) ** -0.5
    r = first + (1 - first) * r
    points = (r * directions * axes).reshape(3, -1)
    masses = (1 - first) * r**2 * shares[:, None, None] * of_cosines[:, None]
    masses = masses.ravel() * mass / masses.sum()
    # The inertia of the half ellipsoid is turned clockwise, but not the weights.
    c = np.cos(skew)
    s = np.sin(skew)
    points = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]) @ points
    points = np.column_stack([points, [x, -y, 0], [-x, y, 0]])
    masses = np.append(masses, [weights, weights])
    total = masses.sum()
    centre = points @ masses / total
    a = height - centre[2]
    points -= centre[:, None]
    tensor = (
        np.eye(3) * (masses * (points**2).sum(axis=0)).sum()
        - (masses * points) @ points.T
    )
    (smaller, larger), axes = np.linalg.eigh(tensor[:2, :2])
    flatter, bent = sorted([height / (length / 2) ** 2, height / (width / 2) ** 2])
    across = 0.0 if length < width else np.pi / 2
    xi = across - np.arctan2(axes[1, 1], axes[0, 1])
    xi -= np.pi * np.round(xi / np.pi)
    unit = total * a**2
    return {
        "alpha": larger / unit + 1,
        "beta": smaller / unit + 1,
        "gamma": tensor[2, 2] / unit,
        "theta": a * bent,
        "phi": a * flatter,
        "xi": xi,
        "c": height / a,
        "mass": total,
        "height": a,
    }


@pytest.mark.parametrize("stone", STONES.values(), ids=STONES.keys())
def test_half_ellipsoids_agree_with_quadrature(stone):
    *five, weights, x, y = stone
    for wall in (np.inf, 0.1 * stone[2], 0.4 * stone[2]):
        body = half_ellipsoid(*five, weights=weights, x=x, y=y, wall=wall)
        assert body == pytest.approx(integrated(*stone, wall), rel=1e-9)


def turned_about_y(tilt, moments):
    """Return an inertia tensor whose z axis is off a principal axis by an angle."""
    c = math.cos(tilt)
    s = math.sin(tilt)
    axes = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])
    return axes @ np.diag(moments) @ axes.T


@pytest.mark.parametrize("close", [1e-3, 0.02, 0.5])
def test_a_vertical_off_a_principal_axis_is_refused_however_close_moments_are(close):
    """A small product of inertia turns axes far if their moments are nearly equal."""
    moments = [9e-5, 6e-6, 9e-5 * (1 + close * 0.06)]
    stone = {"mass": "85 g", "height": "1 cm", "radii": "50, 1.5 cm"}
    for turn in (0.0, 0.4):
        c = math.cos(turn)
        s = math.sin(turn)
        axes = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])

        def tilted(tilt, axes=axes):
            return axes @ turned_about_y(tilt, moments) @ axes.T

        rs.Rattleback.from_si(**stone, axes_angle=0.1, inertia=tilted(0.9e-3))
        for tilt in (1.1e-3, 0.04):
            with pytest.raises(ValueError, match=f"by {tilt:.2g} rad"):
                rs.Rattleback.from_si(**stone, axes_angle=0.1, inertia=tilted(tilt))
    with pytest.raises(ValueError, match=r"off a principal axis by 0\.04 rad"):
        components((9e-5, 6e-6, 9.2e-5, 0, 8e-8))
    # Two equal moments have any axes between them, so a rounding error is no tilt.
    equal = (9e-5, 6e-6, 9e-5)
    assert components((*equal, 0, 1e-21)) == (*equal, 0)
    with pytest.raises(ValueError, match=r"by 0\.79 rad"):
        components((*equal, 0, 1e-9))


QUANTITIES = {
    "length": {"12mm": 0.012, "1.5e1 mm": 0.015, "1 in": 0.0254, "20 µm": 2e-5},
    "moment of inertia": {
        "2.1 kg*cm**2": 2.1e-4,
        "2.1 kg·cm²": 2.1e-4,
        "2.1 g mm2": 2.1e-9,
    },
    "angle": {"-1.5 deg": -math.pi / 120, "90°": math.pi / 2},
    "spin": {"60 rpm": 2 * math.pi, "1 turn/s": 2 * math.pi},
}


@pytest.mark.parametrize("kind", KINDS)
def test_quantities(kind):
    for text, value in QUANTITIES.get(kind, {}).items():
        assert quantity(text, kind) == pytest.approx(value, rel=1e-14), text
    assert quantity(KINDS[kind][1], kind) > 0
    for wrong in (name for name in KINDS if KINDS[name][0] != KINDS[kind][0]):
        with pytest.raises(ValueError, match=f"; an? {wrong} is needed"):
            quantity(KINDS[kind][1], wrong)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("mm", "is not a number with a unit; a length is needed, such as 12 mm"),
        ("12", "has no unit"),
        ("12 foo", "has the unit foo"),
        ("12 mm^3", "is another quantity"),
        ("1,2 cm", "has a decimal comma; write 1.2 cm"),
        ("1,2,3 cm", "has 3 numbers, not 1"),
    ],
)
def test_texts_that_are_no_length_are_refused(text, words):
    with pytest.raises(ValueError, match=words):
        quantity(text, "length")


OPTIONS = (
    "--mass",
    "1kg",
    "--height",
    "1cm",
    "--inertia",
    "2,16,17,-0.2 kg cm^2",
    "--radii",
    "200,4.5 cm",
)


def test_body_prints_both_systems():
    shown = invoke(
        "body",
        *OPTIONS,
        "--n-i",
        "60rpm",
        "--c",
        "2cm",
        "--sigma",
        "1e-4 N m s",
        "--json",
    )
    assert shown.exit_code == 0, shown.stderr
    data = json.loads(shown.stdout)
    second = math.sqrt(0.01 / 9.81)
    assert data["n_i"] == pytest.approx(2 * math.pi * second)
    assert data["si"]["n_i"] == {"value": pytest.approx(60.0), "unit": "rpm"}
    assert data["si"]["t_rgh"] == {
        "value": pytest.approx(data["t_rgh"] * second),
        "unit": "s",
    }
    assert data["si"]["c"] == {"value": pytest.approx(0.02), "unit": "m"}
    # Over M a^2 sqrt(g/a), as in docs/friction.md.
    assert data["sigma"] == pytest.approx(1e-4 / (1e-4 * math.sqrt(981)), rel=1e-14)
    assert "si" not in json.loads(invoke("body", "--preset", "GH", "--json").stdout)
