"""The Python interface that the contract names: single runs, and bad arguments."""

import doctest
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import rattlesweep as rs
from rattlesweep.api import closed, single, sweeps

GH = rs.Rattleback.gh()


def test_the_examples_in_the_package_are_true(tmp_path, monkeypatch):
    shutil.copytree(Path(__file__).parents[2] / "configs", tmp_path / "configs")
    monkeypatch.chdir(tmp_path)
    rs.sweep("configs/gh.yaml", threads=1)
    silent = []
    for module in (closed, single, sweeps):
        assert doctest.testmod(module).failed == 0
        for name in rs.__all__:
            item = getattr(rs, name)
            if getattr(item, "__module__", "") == module.__name__ and not isinstance(item, type):
                silent += [name] if ">>>" not in item.__doc__ else []
    assert silent == []
    assert doctest.testmod(rs) == (0, 3)


def test_every_name_is_there():
    contract = {"Rattleback", "modes", "reversal_time_gh", "bondi_threshold", "growth_rates",
                "simulate", "trajectory", "sweep", "load", "replay", "show", "ConfigError",
                "OutputError"}  # fmt: skip
    assert contract <= set(dir(rs)) == set(rs.__all__)
    assert all(getattr(rs, name) is not None for name in rs.__all__)
    with pytest.raises(AttributeError, match="no attribute 'nonsense'"):
        _ = rs.nonsense
    assert rs.__version__.count(".") == 2


def test_simulate_one_run():
    run = rs.simulate(GH, n_i=0.1, omega_xy0=0.01)
    assert run.t_r == pytest.approx(112.0939, rel=1e-6)
    assert (run.type, run.status, run.t_end) == ("R", "ok", run.t_r)
    assert abs(run.energy_drift) < 1e-9
    assert rs.simulate("GH", n_i=0.1, omega_xy0=0.01) == run
    steady = rs.simulate(GH, n_i=-0.1, omega_xy0=0.01, t_end=100.0)
    assert (steady.t_r, steady.t_end) == (None, 100.0)
    assert steady.type in ("SS", "SW", "unclassified")
    assert rs.simulate(GH, n_i=0.1, omega_xy0=0.01, psi=np.degrees(rs.modes(GH).psi_p)).t_r == (
        pytest.approx(run.t_r, rel=1e-9)
    )
    # The mirror image.
    other = rs.simulate(GH.mirrored(), n_i=-0.1, omega_xy0=0.01)
    assert other.t_r == pytest.approx(run.t_r, rel=1e-9)


def test_a_run_has_all_columns():
    run = rs.simulate(GH, n_i=0.1, omega_xy0=0.01, record=["energy", "error"])
    assert run.t_r_error < 1e-5
    assert run.K_r == rs.modes(GH).K_r
    assert run.to_dict()["energy_0"] == run.energy_0
    assert {"theta", "t_r", "energy_drift_max"} <= set(run.to_dict())
    assert "K_r" in dir(run)
    assert len(repr(run)) < 300
    with pytest.raises(AttributeError, match="a run has no column t_R; there are alpha, beta"):
        _ = run.t_R


def test_an_accuracy_may_be_asked_for():
    loose = rs.simulate("GH", n_i=-0.1, omega_xy0=0.01, accuracy={"t_r": 1e-4})
    tight = rs.simulate("GH", n_i=-0.1, omega_xy0=0.01, accuracy={"t_r": 1e-7})
    assert loose.n_steps < tight.n_steps
    assert loose.t_r_error <= 1e-4 * loose.t_r
    assert abs(loose.t_r - tight.t_r) < 1e-4 * tight.t_r
    draft = rs.trajectory("GH", n_i=0.1, omega_xy0=0.01, t_end=50, accuracy="draft")
    assert draft.n_steps < rs.trajectory("GH", n_i=0.1, omega_xy0=0.01, t_end=50).n_steps


def test_several_dissipations():
    runs = rs.simulate("GH", n_i=0.1, omega_xy0=0.01, sigma=[0, 1e-3], t_end=300)
    assert runs.sigma.tolist() == [0, 1e-3]
    for sigma, t_r in zip(runs.sigma, runs.t_r, strict=True):
        one = rs.simulate("GH", n_i=0.1, omega_xy0=0.01, sigma=sigma, t_end=300)
        assert one.t_r == pytest.approx(t_r, rel=1e-9)
    frame = pd.DataFrame([vars(GH)] * 2).drop(columns=["units", "c"]).assign(sigma=[1e-3, 1e-2])
    own = rs.simulate(frame, n_i=0.1, omega_xy0=0.01, t_end=300)
    assert own.t_r[0] == runs.t_r[1]
    both = rs.simulate(frame, n_i=0.1, omega_xy0=0.01, t_end=300, sigma=0)
    assert both.t_r[0] == pytest.approx(runs.t_r[0], rel=1e-9)


@pytest.mark.slow  # compiles their kernels
def test_simulate_takes_models_and_methods():
    reduced = rs.simulate(GH, n_i=0.1, omega_xy0=0.01, model="reduced", tol=1e-11)
    assert reduced.t_r == pytest.approx(rs.reversal_time_gh(GH, 0.1, 0.01), rel=1e-8)
    paper = rs.simulate(GH, n_i=0.1, omega_xy0=0.01, method="rk4", dt_step=0.002)
    assert paper.t_r == pytest.approx(112.0939, rel=1e-6)
    failed = rs.simulate(GH, n_i=0.1, omega_xy0=0.01, method="rk4", dt_step=3.0)
    assert failed.type is None
    assert failed.status in ("nonfinite", "energy")


def test_bodies():
    body = GH.replace(theta=0.82)
    assert (body.theta, body.phi) == (0.82, GH.phi)
    inertia = (2e-6, 16e-6, 17e-6, -2e-7)
    stone = rs.Rattleback.from_si(mass="1 kg", height="1 cm", radii="30, 1.875 cm", inertia=inertia)
    assert stone == rs.Rattleback.from_si(
        mass=1, height=0.01, radii=(0.3, 0.01875), inertia=inertia
    )


def test_a_page_of_a_launch(tmp_path):
    page = rs.show("GH", n_i=0.1, omega_xy0=0.01, t_end=20, from_time=4, title="Mine & yours")
    assert page.path is None
    assert page._repr_html_().startswith('<iframe sandbox="allow-scripts"')
    assert "Mine &amp;amp; yours" in page._repr_html_()
    saved = page.save(tmp_path / "roll.html")
    assert saved.path.read_bytes() == page.content
    assert b'"start": 4.0' in page.content


def test_a_trajectory_is_used_like_a_table(tmp_path):
    path = rs.trajectory("GH", n_i=0.1, omega_xy0=0.01, t_end=150, channels=["t", "n", "E_p"])
    assert path["n"].equals(path.table.n)
    assert list(path[["t", "E_p"]]) == ["t", "E_p"]
    assert repr(path) == "<Trajectory of t, n, E_p: 2,001 rows, 1 reversal by t = 150, ok>"
    figure = path.plot(tmp_path / "path.svg")
    assert [axes.get_ylabel()[:3] for axes in figure.axes] == ["n (", "E_p"]
    assert (tmp_path / "path.svg").read_text().startswith("<?xml")
    with pytest.raises(rs.ConfigError, match="t and at least one other are needed"):
        rs.trajectory("GH", n_i=0.1, omega_xy0=0.01, t_end=9, channels=["n"]).plot()


LAUNCH = {"n_i": 0.1, "omega_xy0": 0.01}
BAD: list[tuple[Any, str]] = [
    (lambda: GH.replace(tehta=1), "tehta: is no parameter of a body; there are alpha"),
    (lambda: GH.replace(theta="0.6"), r"theta: 0.6 \(str\) is no number"),
    (lambda: GH.replace(theta=np.array([0.5, 0.6])), r"theta: \[0.5 0.6\] \(ndarray\) is no num"),
    (lambda: rs.Rattleback(13, 1.5, 12, 0.6, None, -0.1), r"phi: None \(NoneType\) is no number"),
    (lambda: rs.simulate("HG", **LAUNCH), "bodies: 'HG' .* is no body; give a Rattleback or a na"),
    (lambda: rs.trajectory(3, **LAUNCH), r"body: 3 \(int\) is no body"),
    (lambda: rs.trajectory("GH", n_i=[0.1], omega_xy0=1), r"n_i: one number .* of shape \(1,\)"),
    (lambda: rs.trajectory("GH", n_i="x", omega_xy0=1), "n_i: 'x' .* is no number"),
    (lambda: rs.trajectory("GH", points=2.5, **LAUNCH), "points: 2.5 .* give a whole number from"),
    (lambda: rs.trajectory("GH", omega=[1, 2]), r"omega: a vector .* its shape is \(2,\)"),
    (lambda: rs.trajectory("GH", dt="x", **LAUNCH), "dt: 'x' .* is no number"),
    (lambda: rs.show("GH", sigma=[1, 2], **LAUNCH), "sigma: one number is needed"),
    (lambda: rs.simulate("GH", record="eror", **LAUNCH), '"eror" is not one of energy'),
    (lambda: rs.simulate("GH", accuracy="drft", **LAUNCH), '"drft" is not one of draft'),
    (lambda: rs.simulate("GH", sigma=-1, **LAUNCH), "sigma -1: the dissipation must be finite"),
    (lambda: rs.simulate("GH", tol="x", **LAUNCH), 'integrator.tol: "x" .* write a number'),
    (lambda: rs.simulate("GH", method="rk4", tol=1e-9, **LAUNCH), "takes no tol"),
    (lambda: rs.simulate("GH", dt_step=0.1, **LAUNCH), "chooses its own steps and takes no dt"),
    (lambda: rs.growth_rates("GH", "a"), "n: 'a' .* is no number"),
    (lambda: rs.load(3), r"directory: 3 \(int\) is no path"),
    (lambda: rs.sweep(3), "give a dict"),
    (lambda: rs.replay("x", 1.5, 0), r"case: 1.5 \(float\) is no count"),
]


@pytest.mark.parametrize(("call", "words"), BAD, ids=[words[:20] for _, words in BAD])
def test_bad_arguments_get_a_sentence(call, words):
    with pytest.raises(ValueError, match=words) as told:
        call()
    assert "\n" not in str(told.value)
