"""Rows before a launch, and rows at the limit of a gyroscope, are left out."""

from __future__ import annotations

import numpy as np
import pytest
from natural import natural

import rattlesweep as rs
from rattlesweep.analysis.fit.film import read_film
from rattlesweep.analysis.fit.launched import from_the_launch

BODY = rs.Rattleback.half_ellipsoid(
    length="12 cm", width="3 cm", height="12 mm", mass="60 g", skew="3 deg"
)
STEP = 0.01  # seconds


def noise(size, count, seed=1):
    return size * np.random.default_rng(seed).normal(size=count)


def run_of(n_i, omega_xy0, channels):
    """Return a run of 200 rows in SI units and degrees."""
    units = BODY.units
    launch = natural(n_i=n_i * units.time, omega_xy0=omega_xy0 * units.time)
    end = natural(t_end=199 * STEP / units.time)
    table = rs.trajectory(
        BODY, **launch, **end, points=199, channels=["t", *channels]
    ).table
    return {"gyro_rad_s": -table.omega_z / units.time, "angle_deg": table.angle_deg}


@pytest.fixture(scope="module")
def launched():
    """A run of 60 rpm and a push of 6 rpm, with the noise of a phone and of a film."""
    run = run_of(2 * np.pi, 0.2 * np.pi, ["omega_z", "angle_deg"])
    count = len(run["angle_deg"])
    return {
        "gyro_rad_s": run["gyro_rad_s"].to_numpy() + noise(0.02, count),
        "angle_deg": run["angle_deg"].to_numpy() + noise(0.4, count),
    }


def read(column, values):
    times = STEP * np.arange(len(values))
    film = read_film({"t_s": times, column: values}, BODY.units)
    return from_the_launch(film, None)


@pytest.mark.parametrize("rest", [10, 80])
@pytest.mark.parametrize("column", ["gyro_rad_s", "angle_deg"])
def test_a_film_begins_with_its_launch(launched, column, rest):
    values = launched[column]
    before = noise(0.02, rest, 2)
    if column == "angle_deg":
        before = values[0] + noise(0.4, rest, 2)
    film = read(column, np.concatenate([before, values]))
    assert len(film.t) == len(values)
    assert film.t[0] == 0
    assert film.notes[0].startswith(f"the stone is launched at row {rest + 1}, ")
    assert read(column, values).notes == ()


def test_the_rows_in_which_a_hand_turns_the_stone_are_left_out(launched):
    values = launched["gyro_rad_s"]
    ramp = values[0] * np.linspace(0.1, 0.94, 8)
    film = read("gyro_rad_s", np.concatenate([noise(0.02, 80, 2), ramp, values]))
    assert film.notes[0].startswith("the stone is launched at row 89, ")


@pytest.mark.parametrize("push", [2.0, 6.0, 12.0])
@pytest.mark.parametrize("column", ["gyro_rad_s", "angle_deg"])
def test_a_tap_has_no_rest_before_it(push, column):
    values = run_of(0.0, push, ["omega_z", "angle_deg"])[column].to_numpy()
    size = {"gyro_rad_s": 0.02, "angle_deg": 0.3}[column]
    film = read(column, values + noise(size, len(values)))
    assert film.notes == ()


def test_rows_at_the_limit_of_a_gyroscope_are_left_out(launched):
    values = launched["gyro_rad_s"]
    limit = np.quantile(values, 0.8)
    film = read("gyro_rad_s", np.clip(values, -limit, limit))
    clipped = np.abs(values) >= limit
    beside = [clipped[max(0, i - 2) : i + 3].any() for i in range(len(clipped))]
    assert np.array_equal(~film.known, beside)
    assert f"{clipped.sum()} rows, from row " in film.notes[0]
    assert "at the limit of the sensor" in film.notes[0]
    # Numbers with few digits are equal elsewhere, too.
    assert read("gyro_rad_s", np.round(values, 0)).notes == ()
    with pytest.raises(rs.ConfigError, match="spin the stone more slowly, or film it"):
        read("gyro_rad_s", np.clip(values, -3.0, 3.0))
