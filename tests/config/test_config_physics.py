"""Configs that are well written and make no physical sense: what is refused, what is warned of."""

from pathlib import Path

import numpy as np
import pytest
from numba.core import event
from test_config import CONFIGS, SPIN, variants

import rattlesweep as rs
from rattlesweep.errors import ConfigError
from rattlesweep.integrate.tableau import METHODS
from rattlesweep.sweeps.bodies.sampler import draw_bodies
from rattlesweep.sweeps.config.read import load_config, parse_config
from rattlesweep.sweeps.config.schema import SdSource, Target
from rattlesweep.sweeps.plan import make_plan
from rattlesweep.sweeps.plausible import (
    check_physics,
    checked_plan,
    stability_limit,
    target_findings,
)

DRAWN = "bodies: {source: sd}\n" + SPIN
# As in test_config: a config, what is changed, into what, whether it is refused, what is said.
CASES = r"""
preset | + | integrator: {method: rk4, dt: 3} | refused | 3: integrator.dt: 3 is beyond the stability of rk4 for the only run: dt omega_p must be below 2.83, and omega_p is 1.44; give a smaller dt
drawn | + | integrator: {method: rk4, dt: 0.3} | warned |  of 4096 runs drawn from the ranges: up to their horizons rk4 damps or feeds the
preset | + | horizon: {t_rgh: 0.5} | warned | 3: horizon.t_rgh: the horizon comes before t_rGH, the time of reversal by theory, in the only run, and few will be of type R; give t_rgh above 1
preset | + | horizon: {t: 3} | warned | 3: horizon.t: the horizon of 3 is shorter than one pitch oscillation, 4.37, in
preset | theta: 0.82}}\n | xi: -1e-290}}\nhorizon: {t_rgh: 1e30}\n | refused | 2: horizon.t_rgh: t_rgh times t_rGH is not a finite time in the only run
sd | K_r: [0.01, 0.03, 0.1] | K_r: [0.01, 7] | refused | 7: bodies.target.K_r: 7 is out of reach: in 65536 bodies drawn from the ranges K_r lies between
sd | rel_tol: 1e-3 | rel_tol: 1e-12, max_draws: 4611686018427387904 | refused | hours for each; give
sd | rel_tol: 1e-3 | max_draws: 10000 | warned | e+03 draws a body, but max_draws is 10000, and a sample that misses the target ends the sweep; give
preset | theta: 0.82 | gamma: 14 | refused | no body has this inertia: I_zz = gamma = 14 exceeds I_xx + I_yy = 12.562
grid | phi: [0.02, 0.036] | alpha: [13, 20] | refused | 1: bodies.axes: at alpha 20, beta 1.522, gamma 12.28, theta 0.6, phi 0.036,
table | bodies.csv | nowhere.csv | refused | 1: bodies.path: nowhere.csv: no such file
shell | + | model: reduced | refused | 5: record: the model 'reduced' has no
"""  # noqa: E501


def judged(path):
    """Whether a config is refused, and the lines about it; nothing is drawn for a target."""
    config = load_config(path)
    try:
        if isinstance(config.bodies, SdSource):
            return False, check_physics(make_plan(config))
        return False, checked_plan(config, path.parent)[1]
    except ConfigError as error:
        return True, error.messages


@pytest.mark.parametrize(("text", "verdict", "words"), variants(CASES, drawn=DRAWN))
def test_what_makes_no_sense_is_told_with_place_and_numbers(
    text, verdict, words, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    Path("c.yaml").write_text(text)
    with event.install_recorder("numba:compile") as compiled:
        fatal, lines = judged(Path("c.yaml"))
    assert not compiled.buffer
    assert fatal is (verdict == "refused"), lines
    assert any(words in line for line in lines), lines
    assert all(line.startswith("c.yaml:") and line.isprintable() for line in lines)
    assert (fatal, lines) == judged(Path("c.yaml"))  # the same sample of bodies every time


@pytest.mark.parametrize("path", CONFIGS, ids=lambda path: path.stem)
def test_the_projects_own_configs_make_sense(path):
    assert judged(path) == (False, [])


@pytest.mark.parametrize(
    ("columns", "rows", "fatal", "words"),
    [
        (",n_i,omega_xy0,t_end", (",0.1,0.01,2", ",-0.1,0.01,1"), False,
         "c.yaml:1: bodies.path: the horizon of 1 to 2 is shorter than one pitch oscillation, "
         "4.37, in all of the 2 runs, and no type can be told; give a longer one"),
        (",n_i,omega_xy0", (",0.1,0.01", ",1e160,0.01"), True,
         "c.yaml:1: bodies.path: t.csv: row 2: n_i is 1e+160; from -1000 to 1000 sqrt(g/a)"),
        ("", ("",), True, "c.yaml:1: spin: missing; the table has no columns n_i and omega_xy0"),
    ],
)  # fmt: skip
def test_rows_of_a_table_are_judged_by_themselves(columns, rows, fatal, words, tmp_path):
    body = "13.04,1.522,12.28,0.6429,0.036,-0.03"
    lines = (f"alpha,beta,gamma,theta,phi,xi{columns}", *(body + row for row in rows))
    (tmp_path / "t.csv").write_text("\n".join(lines) + "\n")
    (tmp_path / "c.yaml").write_text("bodies: {source: table, path: t.csv}\n")
    found, [line] = judged(tmp_path / "c.yaml")
    assert found is fatal
    assert words in line


# -- against the runs themselves, the sampler, and other ways to compute ---------------------------


@pytest.mark.slow  # the kernel of rk4
@pytest.mark.parametrize(("dt", "allowed"), [(0.2, {"ok"}), (1.0, {"coarse_step", "energy"})])
def test_steps_are_judged_as_the_runs_are(dt, allowed, tmp_path):
    """In the second, either may be noticed first."""
    data = {
        "bodies": {"source": "preset", "name": "GH"},
        "spin": {"n_i": [0.1, -0.1], "omega_xy0": 0.01},
        "horizon": {"t_rgh": 2},
        "integrator": {"method": "rk4", "dt": dt},
        "output": str(tmp_path / "out"),
    }
    warned = checked_plan(parse_config(data))[1]
    assert bool(warned) == (allowed != {"ok"})
    assert set(rs.sweep(data).runs["status"]) <= allowed


def test_the_stability_of_rk4_is_the_textbooks():
    # Hairer and Wanner, Solving ODEs II, IV.2: 2 sqrt(2) on the imaginary axis.
    assert stability_limit(METHODS["rk4"]) == pytest.approx(2 * np.sqrt(2), abs=2e-3)


@pytest.mark.parametrize("value", [0.01, 0.1])
def test_the_draws_told_for_a_target_are_the_samplers(value):
    source = SdSource(source="sd", samples=400, target=Target(K_r=value, max_draws=10))
    [(_, sentence, _)] = target_findings(source)
    told = float(sentence.split("takes about ")[1].split(" draws a body")[0])
    ranges = np.array(source.ranges.ends())
    _, draws = draw_bodies(5, np.arange(400), ranges, Target(K_r=[value]), value)
    # 400 draws of a geometric law scatter by 5 %, the estimate from a few dozen bodies by 18 %.
    assert told == pytest.approx(draws.mean(), rel=0.6)
