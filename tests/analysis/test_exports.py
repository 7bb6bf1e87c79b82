"""Files of Tracker and phyphox are read as they are; what they leave open is asked."""

from __future__ import annotations

import math

import numpy as np
import pytest
from natural import natural

import rattlesweep as rs
from rattlesweep.analysis.fit.film import read_film

BODY = rs.Rattleback.half_ellipsoid(
    length="12 cm", width="3 cm", height="12 mm", mass="60 g", skew="3 deg"
)
T = np.arange(40) / 120
ANGLE = 0.3 + 9 * T - T**2
X = 50 * np.cos(ANGLE)
Y = 50 * np.sin(ANGLE)
FOLDED = np.angle(np.exp(1j * ANGLE))
TRACKER = "mass A\nt\tx\ty\tθ_{r}\n"
PHYPHOX = '"Time (s)","Gyroscope x (rad/s)","Gyroscope y (rad/s)",'
PHYPHOX += '"Gyroscope z (rad/s)","Absolute (rad/s)"\n'


def lines(*columns, separator="\t", comma=False, end=""):
    """Return rows of numbers as Java writes them."""
    text = ""
    for row in zip(*columns, strict=True):
        line = separator.join("" if math.isnan(x) else f"{x:.9E}" for x in row) + end
        text += (line.replace(".", ",") if comma else line) + "\n"
    return text


def seen(tmp_path, text, n_i=None, encoding="utf-8"):
    path = tmp_path / "export.txt"
    path.write_text(text, encoding)
    return read_film(path, BODY.units, n_i=n_i)


@pytest.mark.parametrize(
    ("head", "columns", "style"),
    [
        (TRACKER, (T, X, Y, np.degrees(FOLDED)), {}),
        (TRACKER, (T, X, Y, np.degrees(FOLDED)), {"comma": True}),
        (TRACKER, (T, X, Y, FOLDED), {}),
        (
            ";mass A;;;;\nt;x;y;θr;\n",
            (T, X, Y, np.degrees(FOLDED)),
            {"separator": ";", "comma": True, "end": ";"},
        ),
        ("#multi:\n\tA\t\tB\t\t\nt\tx\ty\tx\ty\t\n", (T, -X, -Y, X, Y), {"end": "\t"}),
        ("t_s,x1_px,y1_px,x2_px,y2_px\n", (T, -X, Y, X, -Y), {"separator": ","}),
        ("t_s,x1,y1,x2,y2\n", (T, -X, -Y, X, Y), {"separator": ","}),
    ],
    ids=["tabs", "commas", "radians", "semicolons", "two-masses", "pixels", "marks"],
)
def test_an_angle_is_read_from_marks(tmp_path, head, columns, style):
    film = seen(tmp_path, head + lines(*columns, **style), n_i=0.2)
    assert film.kind == "angle"
    assert film.t * BODY.units.time == pytest.approx(T, abs=1e-8)
    # An axis has no front.
    turned = film.value - ANGLE
    assert turned == pytest.approx(turned[0], abs=1e-6)
    assert math.remainder(turned[0], math.pi) == pytest.approx(0, abs=1e-6)


def test_a_gap_of_marks_is_a_gap_of_the_angle(tmp_path):
    columns = [column.copy() for column in (T, X, Y, np.degrees(FOLDED))]
    for column in columns[1:]:
        column[5:8] = np.nan
    film = seen(tmp_path, TRACKER + lines(*columns))
    assert np.flatnonzero(~film.known).tolist() == [5, 6, 7]


@pytest.mark.parametrize("separator", [",", "\t", ";"])
def test_a_phone_tells_the_rate_about_its_own_axis(tmp_path, separator):
    rate = 9 - 2 * T
    head = PHYPHOX.replace(",", separator)
    rows = lines(T + 2, 0.1 * rate, 0 * T, rate, rate, separator=separator)
    film = seen(tmp_path, head + rows)
    assert film.kind == "gyro"
    assert film.value / BODY.units.time == pytest.approx(rate)
    assert film.t[0] == 0


@pytest.mark.slow
def test_the_rate_of_a_phone_is_fitted_with_the_tilt_of_the_stone():
    """On a tilted stone the rate about its own axis is not the spin."""
    truth = {"n_i": 0.3, "omega_xy0": 0.1, "sigma": 4e-3}
    run = rs.trajectory(
        BODY, **natural(**truth, t_end=60), points=300, channels=["t", "n", "omega_z"]
    ).table
    size = 1 / BODY.units.time
    data = {
        "Time (s)": run.t_s,
        "Gyroscope z (rad/s)": -size * run.omega_z.to_numpy(),
    }
    launch = natural(n_i=0.31, omega_xy0=0.1)
    fit = rs.fit(BODY, data, free=["n_i", "sigma"], launch=launch)
    for name in ("n_i", "sigma"):
        assert fit.values[name] == pytest.approx(truth[name], rel=1e-5)


@pytest.mark.parametrize(
    ("text", "question"),
    [
        ("mass A\nt\tx\ty\n" + lines(T, X, Y), "x and y of one mark are no angle"),
        (
            "mass A\nt\tθ_{r}\n" + lines(T, 20 + T),
            "in degrees or in radians",
        ),
        (
            "t_s,x1,y1,x2,y2\n" + lines(T, -X, -Y, X, Y, separator=","),
            "does y1 count up or down",
        ),
        (PHYPHOX + lines(T, 9 + T, T, T, 9 + T, separator=","), "lay the phone flat"),
        ("A\nt\tθ_{r}\tθ_{r}\n" + lines(T, X, Y), "it has 2 angles"),
        ("A\nt\tx\ty\tx\ty\tx\ty\n" + lines(T, X, Y, X, Y, X, Y), "of two marks"),
    ],
)
def test_what_an_export_leaves_open_is_asked_for(tmp_path, text, question):
    if "degrees or" in question:
        text = text.replace("E+01", "E-01")
    with pytest.raises(rs.ConfigError, match=question):
        seen(tmp_path, text)
