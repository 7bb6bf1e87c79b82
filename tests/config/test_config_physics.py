"""Configs that are well written and make no physical sense: what is refused, what is warned of."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numba.core import event
from test_config import GRID, PRESET, SHELL, SPIN, changed

import rattlesweep as rs
from rattlesweep.errors import ConfigError
from rattlesweep.integrate.tableau import METHODS
from rattlesweep.sweeps.cases.plan import make_plan
from rattlesweep.sweeps.cases.sampler import draw_bodies
from rattlesweep.sweeps.config.bodies import SdSource, Target
from rattlesweep.sweeps.config.load import load_config, parse_config
from rattlesweep.sweeps.sense import (
    check_physics,
    checked_plan,
    stability_limit,
    target_findings,
)

CONFIGS = Path(__file__).parents[2] / "configs"


DRAWN = "bodies: {source: sd}\n" + SPIN
RK4 = "integrator: {method: rk4, dt: DT}\n"

# name: (config, refused, words)
CASES = {
    "step beyond stability": (PRESET + RK4.replace("DT", "3"), True,
     "c.yaml:3:27: integrator.dt: 3 is beyond the stability of rk4 for the only run: dt omega_p "
     "must be below 2.83, and omega_p is 1.44; dt 1 would"),
    "step beyond stability in ranges": (DRAWN + RK4.replace("DT", "4"), True,
     "c.yaml:3:27: integrator.dt: 4 is beyond the stability of rk4 for all of 4096 runs drawn "
     "from the ranges: dt omega_p must be below 2.83, and omega_p is 0."),
    "step too coarse": (PRESET.replace("-0.1", "0.1") + RK4.replace("DT", "1"), False,
     "c.yaml:3:27: integrator.dt: 1 is too coarse for the only run: up to their horizons "
     "rk4 damps or feeds the oscillation by more than 10 %, and they end as coarse_step or "),
    "step too coarse for some": (DRAWN + RK4.replace("DT", "0.3"), False,
     " of 4096 runs drawn from the ranges: up to their horizons rk4 damps or feeds the"),
    "step of the reduced model": (PRESET + "model: reduced\n" + RK4.replace("DT", "1000"), False,
     "c.yaml:4:27: integrator.dt: 1000 is longer than the oscillation's energy takes to grow"),
    "step too small": (PRESET + RK4.replace("DT", "1e-9"), True,
     "c.yaml:3:1: integrator.max_steps: 100000000 steps of dt 1e-09 end at 0.1, before the "
     "horizon and before a tenth of t_rGH"),
    "too few steps": (PRESET + "integrator: {max_steps: 3}\n", True,
     "c.yaml:3:14: integrator.max_steps: 3 steps of a whole pitch period each end at"),
    "too few steps for some": (DRAWN + "integrator: {max_steps: 300}\n", False,
     "c.yaml:3:14: integrator.max_steps: 300 steps of a whole pitch period each do not reach "
     "the horizon, "),
    "a horizon beyond all steps": (PRESET + "horizon: {t: 1e12}\n", False,
     "c.yaml:1:1: integrator.max_steps: 100000000 steps of a whole pitch period each do not "
     "reach the horizon, 1e+12, in the only run"),
    "a horizon before any reversal": (PRESET + "horizon: {t_rgh: 0.5}\n", False,
     "c.yaml:3:11: horizon.t_rgh: the horizon comes before t_rGH, the time of reversal by "
     "theory, in the only run, and few will be of type R; give t_rgh above 1"),
    "a horizon before most reversals": (DRAWN + "horizon: {t: 100}\n", False,
     "c.yaml:3:11: horizon.t: the horizon comes before t_rGH, the time of reversal by theory, "
     "in all of 4096 runs drawn from the ranges"),
    "a horizon below one oscillation": (PRESET + "horizon: {t: 3}\n", False,
     "c.yaml:3:11: horizon.t: the horizon of 3 is shorter than one pitch oscillation, 4.37, in"),
    "an endless horizon": (PRESET.replace("theta: 0.82", "xi: -1e-290")
     + "horizon: {t_rgh: 1e30}\n", True,
     "c.yaml:3:11: horizon.t_rgh: t_rgh times t_rGH is not a finite time in the only run"),
    "a target out of reach": (changed("K_r: [0.01, 0.03, 0.1]", "K_r: [0.01, 7]"), True,
     "c.yaml:7:12: bodies.target.K_r: 7 is out of reach: in 65536 bodies drawn from the ranges "
     "K_r lies between "),
    "a target below reach": (
     changed("minus_xi_deg: [0, 6]", "minus_xi_deg: [3, 6]").replace("0.01, 0.03", "1e-4"), True,
     "bodies.target.K_r: 0.0001 is out of reach: "),
    "a target for ever": (changed("rel_tol: 1e-3", f"rel_tol: 1e-12, max_draws: {2**62}"), True,
     "hours for each; give"),
    "a target never met": (changed("rel_tol: 1e-3", "max_draws: 10"), True,
     "e+03 draws a body, by 65536 bodies drawn from "
     "the ranges, but max_draws is 10; give"),
    "a target sometimes missed": (changed("rel_tol: 1e-3", "max_draws: 10000"), False,
     "and one miss ends the sweep; give"),
    "a target that takes hours": (
     changed("rel_tol: 1e-3", f"rel_tol: 1e-9, max_draws: {10**12}"), False,
     " in all: hours; give other ranges"),
    "inertia of no body": (PRESET.replace("theta: 0.82", "gamma: 14"), True,
     "c.yaml:1:36: bodies.overrides: no body has this inertia: I_zz = gamma = 14 exceeds I_xx + "
     "I_yy = 12.562"),
    "inertia of no body in a grid": (GRID.replace("phi: [0.02, 0.036]", "alpha: [13, 20]"), True,
     "c.yaml:1:44: bodies.axes: at alpha 20, beta 1.522, gamma 12.28, theta 0.6, phi 0.036, "),
    "no table": ("bodies: {source: table, path: nowhere.csv}\n" + SPIN, True,
     "c.yaml:1:25: bodies.path: nowhere.csv: no such file"),
    "a recording of another model": (SHELL + "model: reduced\n", True,
     "c.yaml:5:1: record: the model 'reduced' has no"),
    "errors of the closed form": (
     SHELL.replace("[contact, energy]", "[error]") + "model: gh\n", True,
     "c.yaml:5:1: record: the model 'gh' has no 'error' to record"),
    "reversals of the closed form": (
     SHELL.replace("[contact, energy]", "[reversals]") + "model: gh\n", True,
     "c.yaml:5:1: record: the model 'gh' has no 'reversals' to record"),
}  # fmt: skip


def judged(path: Path) -> tuple[bool, list[str]]:
    """Whether a config is refused, and the lines about it; nothing is drawn for a target."""
    config = load_config(path)
    try:
        if isinstance(config.bodies, SdSource):
            return False, check_physics(make_plan(config))
        return False, checked_plan(config, path.parent)[1]
    except ConfigError as error:
        return True, error.messages


@pytest.mark.parametrize("name", CASES)
def test_what_makes_no_sense_is_told_with_place_and_numbers(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    text, refused, words = CASES[name]
    monkeypatch.chdir(tmp_path)
    Path("c.yaml").write_text(text)
    with event.install_recorder("numba:compile") as compiled:
        fatal, lines = judged(Path("c.yaml"))
    assert not compiled.buffer
    assert fatal is refused, lines
    assert any(words in line for line in lines), lines
    for line in lines:
        assert line.startswith("c.yaml:")
        assert line.isprintable()
        assert len(line) < 500


@pytest.mark.parametrize("path", sorted(CONFIGS.glob("*.yaml")), ids=lambda path: path.stem)
def test_the_projects_own_configs_make_sense(path: Path) -> None:
    assert judged(path) == (False, [])


def test_rows_of_a_table_are_judged_by_their_own_horizons(tmp_path: Path) -> None:
    body = "13.04,1.522,12.28,0.6429,0.036,-0.03"
    (tmp_path / "t.csv").write_text(
        f"alpha,beta,gamma,theta,phi,xi,n_i,omega_xy0,t_end\n{body},0.1,0.01,2\n{body},-0.1,0.01,1\n"
    )
    (tmp_path / "c.yaml").write_text("bodies: {source: table, path: t.csv}\n")
    fatal, [line] = judged(tmp_path / "c.yaml")
    assert not fatal
    assert line.endswith(
        "c.yaml:1:25: bodies.path: the horizon of 1 to 2 is shorter than one pitch oscillation, "
        "4.37, in all of the 2 runs, and no type can be told; give a longer one"
    )
    (tmp_path / "t.csv").write_text(
        f"alpha,beta,gamma,theta,phi,xi,n_i,omega_xy0\n{body},0.1,0.01\n{body},1e160,0.01\n"
    )
    fatal, [line] = judged(tmp_path / "c.yaml")
    assert fatal
    assert "c.yaml:1:25: bodies.path: t.csv: row 2: n_i is 1e+160; at most 1e+06 is allowed" in line
    (tmp_path / "t.csv").write_text(f"alpha,beta,gamma,theta,phi,xi,t_end\n{body},1e300\n")
    fatal, [line] = judged(tmp_path / "c.yaml")
    assert fatal
    assert "row 1: t_end is 1e+300; at most 1e+30 is allowed" in line
    (tmp_path / "t.csv").write_text(f"alpha,beta,gamma,theta,phi,xi\n{body}\n")
    fatal, [line] = judged(tmp_path / "c.yaml")
    assert fatal
    assert "c.yaml:1:1: spin: missing; the table has no columns n_i and omega_xy0" in line


# -- against the runs themselves, the sampler, and other ways to compute --------------------------


@pytest.mark.slow
@pytest.mark.parametrize(("dt", "allowed"), [(0.2, {"ok"}), (1.0, {"coarse_step", "energy"})])
def test_steps_are_judged_as_the_runs_are(dt: float, allowed: set[str], tmp_path: Path) -> None:
    """In the second, either may be noticed first; the kernel of rk4 is compiled."""
    data: dict[str, Any] = {
        "bodies": {"source": "preset", "name": "GH"},
        "spin": {"n_i": [0.1, -0.1], "omega_xy0": 0.01},
        "horizon": {"t_rgh": 2},
        "integrator": {"method": "rk4", "dt": dt},
        "output": str(tmp_path / "out"),
    }
    warned = checked_plan(parse_config(data))[1]
    assert bool(warned) == (allowed != {"ok"})
    assert set(rs.sweep(data).runs["status"]) <= allowed


def test_the_stability_of_rk4_is_the_textbooks() -> None:
    # Hairer and Wanner, Solving ODEs II, IV.2: 2 sqrt(2) on the imaginary axis.
    assert stability_limit(METHODS["rk4"]) == pytest.approx(2 * np.sqrt(2), abs=2e-3)


@pytest.mark.parametrize("value", [0.01, 0.1])
def test_the_draws_told_for_a_target_are_the_samplers(value: float) -> None:
    source = SdSource(source="sd", samples=400, target=Target(K_r=value, max_draws=10))
    [(_, sentence, fatal)] = target_findings(source)
    assert fatal
    told = float(sentence.split("takes about ")[1].split(" draws a body")[0])
    ranges = np.array(source.ranges.ends())
    _, draws, _ = draw_bodies(5, 0, np.arange(400), ranges, 2, value, 1e-3, 10**6)
    # 400 draws of a geometric law scatter by 5 %, the estimate from a few dozen bodies by 18 %.
    assert told == pytest.approx(draws.mean(), rel=0.6)


def test_the_same_answer_every_time_and_for_any_seed(tmp_path: Path) -> None:
    path = tmp_path / "c.yaml"
    path.write_text(DRAWN + RK4.replace("DT", "0.3"))
    first = judged(path)
    assert first == judged(path)
    assert first[1] == check_physics(make_plan(load_config(path, ["seed=5"])))
