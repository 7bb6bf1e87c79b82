"""Fits of films made under creep, viscous slip and a plane that shakes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_array_equal
from refusal import assert_refused
from sweeping import invoke

import rattlesweep as rs
from rattlesweep.analysis.fit.problem import FITTABLE
from rattlesweep.analysis.fit.trials import follow_quantity
from rattlesweep.api.single import launch_of
from rattlesweep.cli.given import prepare_stone, read_stone

STONE = """\
body:
  {shape: half_ellipsoid, length: 12 cm, width: 3 cm, height: 12 mm, mass: 60 g,
   skew: 3 deg}
launch: {n_i: %s, omega_xy0: %s}
"""
SPUN = STONE % ("60 rpm", "10 rpm")
SHAKEN = STONE % ("0", "10 rpm")
DRIVE = "base: {frequency: 19.5 Hz, amplitude: 0.1 mm, phase_deg: 40}\n"
COUPLE = "dissipation: {sigma: 3e-6 N m s}\n"
BODY = rs.Rattleback.half_ellipsoid(
    length="12 cm", width="3 cm", height="12 mm", mass="60 g", skew="3 deg"
)


def filmed(tmp_path, text, time="3 s"):
    """Return a synthetic film of a stone file."""
    path = tmp_path / "truth.yaml"
    path.write_text(text)
    film = invoke("film", path, "--time", time)
    assert film.exit_code == 0, film.stderr
    (tmp_path / "film.csv").write_text(film.stdout)
    return tmp_path / "film.csv"


def fitted(tmp_path, text, film):
    """Return value, interval and unit of each free parameter, from the command."""
    path = tmp_path / "stone.yaml"
    path.write_text(text + "error: 0.5 deg\n")
    result = invoke("fit", path, film, "-q")
    assert result.exit_code == 0, result.stderr
    rows = {}
    for line in result.stdout.splitlines()[1:]:
        if line.startswith("correlations"):
            break
        name, *numbers = line.split()
        rows[name] = [float(x) for x in numbers[:3]]
    return rows


@pytest.mark.slow
@pytest.mark.parametrize(
    ("text", "given", "free", "truth"),
    [
        pytest.param(
            SPUN + "dissipation: {pivot: 40 um, creep: 0.3}\n",
            SPUN + "dissipation: {pivot: 40 um}\n",
            "[n_i, omega_xy0, pivot, creep]",
            {"pivot": 40e-6 / 7.5e-3, "creep": 0.3},
            id="creep",
        ),
        pytest.param(
            SPUN + "dissipation: {viscous: 200 N s/m}\n",
            SPUN,
            "[n_i, omega_xy0, viscous]",
            {"viscous": 92.169},
            id="viscous",
        ),
        pytest.param(
            SHAKEN + COUPLE + DRIVE,
            SHAKEN + COUPLE + DRIVE.replace("0.1 mm", "0.11 mm").replace("40", "0"),
            "[omega_xy0, base_acceleration, base_phase]",
            {"base_acceleration": 0.15303, "base_phase": 0.69813},
            id="base",
        ),
        pytest.param(
            SHAKEN + COUPLE + DRIVE,
            SHAKEN + COUPLE.replace("3e-6", "2e-6") + DRIVE,
            "[omega_xy0, sigma]",
            {"sigma": 0.024577},
            id="fixed base",
        ),
        pytest.param(
            SPUN + "dissipation: {pivot: 40 um, creep: 0.3}\n",
            SPUN + "dissipation: {pivot: 30 um, creep: 0.3}\n",
            "[n_i, omega_xy0, pivot]",
            {"pivot": 40e-6 / 7.5e-3},
            id="fixed creep",
        ),
    ],
)
def test_fits_find_the_truth_of_a_film(text, given, free, truth, tmp_path):
    film = filmed(tmp_path, text)
    found = fitted(tmp_path, f"{given}free: {free}\n", film)
    for name, value in truth.items():
        _, low, high = found[name]
        assert low < value < high, name


def test_no_fit_reaches_the_zero_at_which_a_law_is_left_out():
    """Creep and slip grow toward a friction of zero, which stands for none of them."""
    for name in ("creep", "viscous", "mu"):
        assert FITTABLE[name].low > 0
    for name in ("sigma", "rolling", "pivot", "base_acceleration"):
        assert FITTABLE[name].low == 0


def test_a_patch_that_does_not_turn_does_not_give_way():
    """A search may try a lever of zero, beside any friction in the patch."""
    plain = launch_of(BODY, n_i="60 rpm", omega_xy0="6 rpm", t_end="0.2 s")
    bare = replace(plain, losses={"pivot": 0.0, "creep": 0.3})
    times = np.linspace(0.0, plain.t_end, 5)
    expected = follow_quantity(plain, "angle", times)
    assert_array_equal(follow_quantity(bare, "angle", times), expected)


def test_what_belongs_to_a_plane_that_shakes_needs_one():
    data = {"t_s": [0.0, 0.1], "angle_deg": [0.0, 1.0]}
    launch = {"n_i": "60 rpm", "omega_xy0": "6 rpm"}
    with pytest.raises(rs.ConfigError) as error:
        rs.fit(BODY, data, free=["base_phase"], launch=launch)
    assert str(error.value) == "free: base_phase is of a plane that shakes; give base"


@pytest.mark.parametrize(
    ("base", "words"),
    [
        ("{frequency: 19.5, amplitude: 0.1 mm}", "base_frequency: 19.5 has no unit"),
        ("{frequency: 19.5 Hz}", "base: give acceleration or amplitude, and not both"),
    ],
)
def test_a_wrong_base_of_a_stone_file_is_refused(base, words, tmp_path):
    path = tmp_path / "stone.yaml"
    path.write_text(f"{SHAKEN}base: {base}\n")
    result = invoke("film", path)
    assert_refused(result, 2, f"{path}:5: base: {words}")


def test_a_run_of_a_stone_file_shakes_and_its_title_says_so(tmp_path):
    path = tmp_path / "stone.yaml"
    path.write_text(SHAKEN + DRIVE)
    run = prepare_stone(read_stone(path), {}, {"t_end": "1 s"})
    assert "ε 0.153024, phase 0.698132 rad" in run.title
    assert run.launches.losses["base_phase"][0] == pytest.approx(0.698132, rel=1e-6)


def test_verdicts_are_about_a_plane_at_rest(tmp_path):
    path = tmp_path / "stone.yaml"
    path.write_text(SHAKEN + DRIVE)
    assert_refused(invoke("verdict", path), 2, "a verdict is about a plane at rest")
    with pytest.raises(rs.ConfigError, match="a verdict is about a plane at rest"):
        rs.verdict(BODY, base={"frequency": "19.5 Hz", "amplitude": "0.1 mm"})
