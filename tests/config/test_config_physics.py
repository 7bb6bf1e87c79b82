"""Valid configs that make no physical sense: errors and warnings."""

from pathlib import Path

import pytest
from numba.core import event
from sweeping import CONFIGS, HEAD, ROW

from configs import SPIN, variants
from rattlesweep.config.body_sources import SdSource
from rattlesweep.config.read import load_config
from rattlesweep.design.plan import make_plan
from rattlesweep.design.plausible import check_physics
from rattlesweep.words.errors import ConfigError
from rattlesweep.work.planning import checked_plan

DRAWN = "bodies: {source: sd}\n" + SPIN
# As `REFUSED` in test_config: a config, the text to replace, the new text, verdict,
# message.
CASES = r"""
preset | + | horizon: {t_rgh: 0.5} | warned | 3: horizon.t_rgh: the horizon comes before t_rGH, the reversal time of theory, in the only run, so few will be of type R; give t_rgh above 1
drawn | + | horizon: {t: 100} | warned | 3: horizon.t: the horizon comes before t_rGH, the reversal time of theory, in all of 4096 runs drawn from the ranges
preset | theta: 0.82}}\n | xi: -1e-290}}\nhorizon: {t_rgh: 1e30}\n | refused | 2: horizon.t_rgh: t_rgh times t_rGH is not a finite time in the only run
sd | K_r: [0.01, 0.03, 0.1] | K_r: [0.01, 7] | refused | 7: bodies.target.K_r: 7 is out of reach: in 65536 bodies drawn from the ranges K_r lies between
sd | minus_xi_deg: [0, 6]}\n  target: {K_r: [0.01, 0.03, | minus_xi_deg: [3, 6]}\n  target: {K_r: [1e-4, | refused | bodies.target.K_r: 0.0001 is out of reach:
preset | theta: 0.82 | gamma: 14 | refused | no body has this inertia: I_zz = gamma = 14 exceeds I_xx + I_yy = 12.562
grid | phi: [0.02, 0.036] | alpha: [13, 20] | refused | 1: bodies.axes: at alpha 20, beta 1.522, gamma 12.28, theta 0.6, phi 0.036,
preset | -0.1 | [0.1, 0] | refused | horizon.t: missing; a launch without spin (2
preset | n_i: -0.1, omega_xy0: 0.01}\n | n_i: 0, omega_xy0: 0.1}\nhorizon: {t: 9}\nmodel: gh\n | refused | 4: model: gh beg
preset | spin: {n_i: -0.1, omega_xy0: 0.01} | launch: {omega: [0, 0, 1]} | refused | t_rgh times t_rGH is not a finite time in the only run
preset | spin: {n_i: -0.1, omega_xy0: 0.01} | launch: {omega: [1, 0, 0]} | refused | horizon.t: missing; a launch without spin has no t_rGH
preset | spin: {n_i: -0.1, omega_xy0: 0.01} | launch: {omega: [0.1, 0, 1]}\nmodel: reduced | refused | 3: model: reduced begins with
table | bodies.csv | nowhere.csv | refused | 1: bodies.path: nowhere.csv: no such file
table | + |  | refused | 1: spin: missing; the table has no columns n_i and omega_xy0
preset | overrides: {theta: 0.82} | c: 0.6 | refused | c 0.6 is not above theta 0.6429: the ellipsoid would tip onto
shell | + | model: reduced | refused | 5: record: the model 'reduced' cannot record
shell | [contact, energy]\n | [error]\nmodel: gh\n | refused | 5: record: the model 'gh' cannot record 'error'
"""  # noqa: E501


def judged(path):
    """Return whether a config is refused, and the messages; no bodies are drawn for
    targets.
    """
    config = load_config(path)
    try:
        if isinstance(config.bodies, SdSource):
            return False, check_physics(make_plan(config))
        return False, checked_plan(config, path.parent)[1]
    except ConfigError as error:
        return True, error.messages


@pytest.mark.parametrize(("text", "verdict", "words"), variants(CASES, drawn=DRAWN))
def test_messages_about_nonsense_have_place_and_numbers(
    text, verdict, words, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    Path("c.yaml").write_text(text)
    Path("bodies.csv").write_text(f"{HEAD}\n{ROW}\n")
    with event.install_recorder("numba:compile") as compiled:
        fatal, lines = judged(Path("c.yaml"))
    assert not compiled.buffer
    assert fatal is (verdict == "refused"), lines
    assert any(words in line for line in lines), lines
    for line in lines:
        assert line.startswith("c.yaml:")
        assert line.isprintable()
        assert len(line) < 500


@pytest.mark.parametrize(
    "path", sorted(CONFIGS.glob("*.yaml")), ids=lambda path: path.stem
)
def test_the_projects_own_configs_make_sense(path):
    assert judged(path) == (False, [])


def test_rows_of_a_table_are_judged_by_themselves(tmp_path):
    rows = f"{HEAD},n_i,omega_xy0,t_end\n{ROW},0.1,0.01,2\n{ROW},-0.1,0.01,1\n"
    (tmp_path / "t.csv").write_text(rows)
    (tmp_path / "c.yaml").write_text("bodies: {source: table, path: t.csv}\n")
    fatal, [line] = judged(tmp_path / "c.yaml")
    assert not fatal
    words = "c.yaml:1: bodies.path: the horizon comes before t_rGH, the reversal time"
    assert f"{words} of theory, in all of the 2 runs, so few will be of type R" in line
