"""Bodies in SI units: what they come to, what cannot be, and quantities as people write them."""

import json
import math
import shlex

import numpy as np
import pytest
from refusal import assert_refused
from sweeping import invoke

import rattlesweep as rs
from rattlesweep.physics.body import PARAMETERS
from rattlesweep.units import KINDS, quantities, quantity

STONE = {
    "mass": 1.0,
    "inertia": (2e-4, 16e-4, 17e-4, -0.2e-4),
    "height": 0.01,
    "radii": (2.0, 0.045),
}
"""Kane and Levinson's: semi-axes 20, 3, 2 cm; the radii are 20^2/2 and 3^2/2 cm."""


def numbers(body):
    return [getattr(body, name) for name in PARAMETERS]


def test_kane_and_levinsons_body():
    body = rs.Rattleback.from_si(**STONE)
    expected = [17.00285656, 2.99714344, 17.0, 0.2 / 0.9, 0.005, -0.01428182892]
    assert numbers(body) == pytest.approx(expected, rel=1e-9)
    assert body.units is not None
    assert (body.units.mass, body.units.length) == (1.0, 0.01)
    assert body.units.time == pytest.approx(math.sqrt(0.01 / 9.81), rel=1e-15)
    assert body.mirrored().units == body.units


@pytest.mark.parametrize("angle", [0.0, 0.4, 1.5, -2.0, 3.0])
@pytest.mark.parametrize("order", [1, -1])
def test_any_axes_and_any_order_of_the_radii(angle, order):
    """A body turned about the vertical is the same body."""
    gh = rs.Rattleback.gh()
    mass, a = 0.2, 0.013
    axes = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
    plane = axes @ np.diag([gh.alpha - 1, gh.beta - 1]) @ axes.T * mass * a**2
    tensor = np.zeros((3, 3))
    tensor[:2, :2], tensor[2, 2] = plane, gh.gamma * mass * a**2
    radii, direction = [a / gh.theta, a / gh.phi], angle + gh.xi
    if order < 0:
        radii, direction = radii[::-1], direction + math.pi / 2
    body = rs.Rattleback.from_si(
        mass=mass, inertia=tensor, height=a, radii=radii, axes_angle=direction
    )
    assert numbers(body) == pytest.approx(numbers(gh), rel=1e-9)
    # Seen from the other side, y is to the other side, and so are all angles.
    flip = np.diag([1, -1, -1])
    seen = rs.Rattleback.from_si(mass=mass, inertia=flip @ tensor @ flip, height=a, radii=radii,
                                 axes_angle=-direction, z_up=True)  # fmt: skip
    assert numbers(seen) == pytest.approx(numbers(gh), rel=1e-9)


def test_texts_with_units():
    text = rs.Rattleback.from_si(
        mass="1000 g", inertia=STONE["inertia"], height="1cm", radii=("200 cm", "45 mm"),
        axes_angle="0 deg",
    )  # fmt: skip
    assert numbers(text) == pytest.approx(numbers(rs.Rattleback.from_si(**STONE)), rel=1e-14)


def test_units_make_no_other_body():
    with_units = rs.Rattleback.from_si(**STONE)
    without = rs.Rattleback(*numbers(with_units))
    assert with_units == without
    assert without.units is None
    assert repr(with_units) == repr(without)


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"mass": 0.0}, "mass is 0; it must be positive"),
        ({"height": "12 kg"}, "height: '12 kg' is a mass; a length is needed, such as 12 mm"),
        ({"height": "12"}, "height: '12' has no unit; a length is needed"),
        ({"inertia": (1e-4, 1e-4, 9e-4)}, "no mass distribution has it, as the principal moment"),
        ({"inertia": (-1e-4, 1e-4, 1e-4)}, "a principal moment is -0.0001 kg m"),
        ({"inertia": (1e-4, 2e-4, 2e-4, 9e-4)}, "a principal moment is"),
        ({"inertia": (1, 2)}, "a matrix of 3 x 3 is needed, or"),
        ({"inertia": np.arange(9.0).reshape(3, 3)}, "the matrix is not symmetric"),
        ({"inertia": (2e-4, 16e-4, 17e-4, 0, 1e-5)}, "the vertical is no principal axis: ixz and"),
        ({"radii": (0.005, 0.1)}, "radii: 0.005 m is not above the height 0.01 m"),
        ({"radii": (0.1, 0.1)}, "phi 0.1 is not below theta 0.1"),
        ({"radii": (1e300, 0.1)}, r"radii: 1e\+300 m is out of range; from 1e-09 to 1e\+06 m is"),
        ({"gravity": 1e30}, r"gravity: 1e\+30 m/s\^2 is out of range; from 1e-06 to 1e\+06 m/s"),
        ({"radii": (0.1,)}, "radii: two are needed, and not 1"),
        ({"inertia": (2e-4, 16e-4, 17e-4)}, "xi is 0 rad"),
    ],
)
def test_what_no_body_can_be(wrong, words):
    with pytest.raises(ValueError, match=words):
        rs.Rattleback.from_si(**(STONE | wrong))


# ------------------------------------------------------------------------------ quantities


QUANTITIES = {
    "length": {"12 mm": 0.012, "12mm": 0.012, "1.5e1 mm": 0.015, "1 in": 0.0254, "20 µm": 2e-5},
    "mass": {"85 g": 0.085},
    "moment of inertia": {"2.1 kg cm^2": 2.1e-4, "2.1 kg*cm**2": 2.1e-4, "2.1 kg·cm²": 2.1e-4,
                          "2.1 g mm2": 2.1e-9},
    "angle": {"-1.5 deg": -math.pi / 120, "90°": math.pi / 2},
    "spin": {"60 rpm": 2 * math.pi, "3 rad/s": 3.0, "1 turn/s": 2 * math.pi},
    "time": {"2 min": 120.0},
    "acceleration": {"9.81 m/s^2": 9.81, "9.81 N/kg": 9.81},
}  # fmt: skip


@pytest.mark.parametrize("kind", QUANTITIES)
def test_quantities(kind):
    for text, value in QUANTITIES[kind].items():
        assert quantity(text, kind) == pytest.approx(value, rel=1e-14), text


@pytest.mark.parametrize("kind", KINDS)
def test_examples_are_what_they_are_for(kind):
    assert quantity(KINDS[kind][1], kind) > 0
    for other in (name for name in KINDS if KINDS[name][0] != KINDS[kind][0]):
        with pytest.raises(ValueError, match=f"; an? {other} is needed"):
            quantity(KINDS[kind][1], other)


NO_LENGTH = {
    "mm": "is not a number with a unit; a length is needed, such as 12 mm",
    "12": "has no unit; a length is needed, such as 12 mm",
    "12 foo": "has the unit foo: 'foo' is not defined",
    "12 kg": "is a mass; a length is needed",
    "12 mm^3": "is another quantity; a length is needed",
    "1,2 cm": "has 2 numbers; 1 is needed",
    "nan m": "is not a number with a unit",
}


@pytest.mark.parametrize("text", NO_LENGTH)
def test_what_is_no_length(text):
    with pytest.raises(ValueError, match=NO_LENGTH[text]):
        quantity(text, "length")
    assert quantities("1, 2 cm", "length", 2) == [0.01, 0.02]


# ---------------------------------------------------------------------------- commands

OPTIONS = ("--mass", "1kg", "--height", "1cm", "--inertia", "2,16,17,-0.2 kg cm^2",
           "--radii", "200,4.5 cm")  # fmt: skip


def test_body_prints_both_systems():
    shown = invoke("body", *OPTIONS, "--n-i", "60rpm", "--json")
    assert shown.exit_code == 0, shown.stderr
    data = json.loads(shown.stdout)
    second = math.sqrt(0.01 / 9.81)
    assert data["alpha"] == pytest.approx(17.00285656)
    assert data["n_i"] == pytest.approx(2 * math.pi * second)
    assert data["units"] == {"mass": 1.0, "length": 0.01, "gravity": 9.81}
    assert data["si"]["n_i"] == {"value": pytest.approx(60.0), "unit": "rpm"}
    assert data["si"]["t_rgh"] == {"value": pytest.approx(data["t_rgh"] * second), "unit": "s"}
    assert data["si"]["omega_p"] == {"value": pytest.approx(data["omega_p"] / second),
                                     "unit": "rad/s"}  # fmt: skip
    table = invoke("body", *OPTIONS).stdout.splitlines()
    (line,) = (line.split() for line in table if line.startswith("t_rgh "))
    assert float(line[3]) == pytest.approx(float(line[1]) * second, rel=1e-4)
    assert line[4] == "s"
    assert "si" not in json.loads(invoke("body", "--preset", "GH", "--json").stdout)


def test_a_trajectory_in_seconds():
    words = ("--n-i", "60rpm", "--omega-xy0", "20 rpm", "--t-end", "10s", "--points", "2")
    shown = invoke("trajectory", *OPTIONS, *words)
    assert shown.exit_code == 0, shown.stderr
    second = math.sqrt(0.01 / 9.81)
    plain = rs.trajectory(
        rs.Rattleback.from_si(**STONE), n_i=2 * math.pi * second,
        omega_xy0=2 * math.pi / 3 * second, t_end=10 / second,
    )  # fmt: skip
    assert plain.reversals.size
    seconds = ", ".join(f"{t * second:.4g} s" for t in plain.reversals[:8])
    assert f"({seconds})" in shown.stderr


@pytest.mark.parametrize("c", [0.02, "2 cm", "20mm"])
def test_the_vertical_semi_axis_of_an_ellipsoid(c):
    """Kane and Levinson's is 2 cm, twice the height."""
    body = rs.Rattleback.from_si(**STONE, c=c)
    assert body.c == 2
    assert numbers(body) == pytest.approx(numbers(rs.Rattleback.kl()), rel=1e-12)
    with pytest.raises(ValueError, match=r"not above theta 0\.222222: the ellipsoid's horizontal"):
        rs.Rattleback.from_si(**STONE, c="2 mm")
    with pytest.raises(ValueError, match="c: '2 kg' is a mass; a length is needed"):
        rs.Rattleback.from_si(**STONE, c="2 kg")


@pytest.mark.parametrize("c", ["2cm", "0.02m", "2"])
def test_semi_axis_and_dissipation_with_units(c):
    """Of a semi-axis a plain number is in units of the height, as of a body without units."""
    told = invoke("body", *OPTIONS, "--c", c, "--sigma", "1e-4 N m s", "--json")
    assert told.exit_code == 0, told.output
    data = json.loads(told.stdout)
    assert data["c"] == 2
    assert data["si"]["c"] == {"value": pytest.approx(0.02), "unit": "m"}
    # Over M a^2 sqrt(g/a), as docs/dynamics.md has it.
    assert data["sigma"] == pytest.approx(1e-4 / (1e-4 * math.sqrt(981)), rel=1e-14)
    assert data["si"]["sigma"] == {"value": pytest.approx(1e-4), "unit": "N m s"}
    rolling = json.loads(invoke("body", *OPTIONS, "--rolling", "50um", "--json").stdout)
    assert rolling["rolling"] == pytest.approx(0.005)
    assert "c" not in rolling


# Of both commands; STONE stands for a body in SI units.
NO_FIT = """
--mass '12 mm' | --mass 12 mm: is a length; a mass is needed, such as 85 g
--mass 85g | --mass is not one whole body; give one of these
--preset GH --mass 1kg | --mass --preset is not one whole body
--preset GH --n-i 60rpm | --n-i has a unit, but the body has no size
--preset GH --n-i '60 mm' | --n-i 60 mm: is a length; a spin is needed
STONE --radii '200 cm' | --radii 200 cm: has 1 number; 2 are needed
STONE --radii '0.5,2 cm' | radii: 0.005 m is not above the height 0.01 m
STONE --inertia '1,2 kg m^2' | has 2 numbers; 3, 4, 5 or 6 are needed
--preset GH --c 2cm | --c has a unit, but the body has no size
STONE --c 2kg | --c 2kg: is a mass; a length is needed, such as 12 mm
STONE --c 2mm | c 0.2 is not above theta 0.222222
STONE --c tall | --c tall: is not a number with a unit; a length is needed
--preset KL --sigma '1e-4 N m s' | --sigma has a unit, but the body has no size; give it with --height, --inertia, --mass, --radii, or a number in M a^2 sqrt(g/a)
--preset KL --rolling 50um | or a number in a
STONE --sigma '1e-4 N m' | --sigma 1e-4 N m: is another quantity; a torque per spin is needed, such as 1e-4 N m s
STONE --sigma '-1e-4 N m s' |  -0.0319
"""  # noqa: E501


@pytest.mark.parametrize("line", NO_FIT.strip().splitlines())
@pytest.mark.parametrize("command", ["body", "trajectory"])
def test_options_that_do_not_fit(command, line):
    typed, words = line.split(" | ")
    options = shlex.split(typed.replace("STONE", shlex.join(OPTIONS)))
    assert_refused(invoke(command, *options), 2, words)
