"""Stored runs again: found by number or condition, equal bit for bit, followed past reversals."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pyarrow.csv as pcsv
import pyarrow.parquet as pq
import pytest
from editing import edited, replaced
from refusal import assert_refused
from sweeping import invoke, rows, run

import rattlesweep as rs
from rattlesweep.analysis import style
from rattlesweep.analysis.onerun import channels
from rattlesweep.analysis.onerun.course import Course
from rattlesweep.analysis.onerun.replay import find_runs
from rattlesweep.integrate.model import ELLIPSOID, FRICTION, FULL
from rattlesweep.physics import full, stone


@pytest.fixture(scope="module")
def sweep(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A small sweep with runs that reverse and runs that do not."""
    output = tmp_path_factory.mktemp("replay") / "out"
    result = run(
        "quickstart.yaml", output, "bodies.samples=8", "record=[windows]",
        "bodies.target={K_r: [0.05], rel_tol: 0.1}", "spin.n_i=[-0.1, -0.5]",
    )  # fmt: skip
    assert result.exit_code == 0
    return output


def bits(value: float) -> bytes:
    return np.float64(value).tobytes()


def test_every_run_is_the_stored_one_bit_for_bit(sweep):
    table = rows(sweep)
    assert 2 <= table["t_r"].notna().sum() < len(table)
    for stored in table.itertuples():
        (one,) = find_runs(sweep, stored.case, stored.sample)
        one.prove()
        course = Course(one.prepare(), steps=True)
        last = list(course)[-1]
        assert course.status.label == stored.status
        if np.isnan(stored.t_r):
            assert course.zeros == []
            assert bits(course.t) == bits(stored.t_end)
            # The channel is formed by NumPy, without fused multiply-add.
            assert last["n"][-1] == pytest.approx(stored.n_end, rel=1e-15)
            assert course.n_steps == stored.n_steps
        else:
            assert bits(course.zeros[0]) == bits(stored.t_r)
            assert course.t > stored.t_end


def test_a_run_can_be_followed_beyond_the_horizon_or_less_far(sweep):
    (run,) = find_runs(sweep, where='type == "R"')
    horizon, one = run.prepare().t_end, SimpleNamespace(**run.values)
    found = rs.replay(sweep, one.case, one.sample, t_end=2 * horizon, points=2)
    assert (len(found.table), found.t_end) == (2, 2 * horizon)
    assert bits(found.zeros[0]) == bits(one.t_r)
    near = rs.replay(sweep, one.case, one.sample, t_end=0.5 * one.t_end, points=2)
    assert len(near.zeros) == 0


def test_several_runs_go_to_files_named_by_run(sweep, tmp_path):
    wanted = rows(sweep).query("n_i == -0.5").iloc[:2]
    result = invoke(
        "replay", sweep, "--where", "n_i == -0.5", "--first", 2, "--points", 4,
        "--output", tmp_path / "run-{case}-{sample}.parquet", "--figure",
        tmp_path / "{sample}.svg", "--channels", "t,n,E_r", "-q",
    )  # fmt: skip
    assert (result.exit_code, result.output) == (0, "")
    names = [f"run-{r.case}-{r.sample}.parquet" for r in wanted.itertuples()]
    drawn = [f"{r.sample}.svg" for r in wanted.itertuples()]
    assert sorted(p.name for p in tmp_path.iterdir()) == sorted(names + drawn)
    first = pq.read_table(tmp_path / names[0]).to_pandas()
    assert list(first.columns) == ["t", "n", "E_r"]
    assert first["n"][0] == pytest.approx(-0.5, rel=1e-12)


def test_runs_are_chosen_by_a_condition(sweep):
    """More of conditions in test_where.py."""
    runs = pd.read_parquet(sweep / "runs").query("sample in (1, 3, 5) and t_r * 2 < t_rgh * 3")
    text = "sample in (1, 3, 5) and t_r * 2 < 3 * t_rgh"
    for first in (1, 2, 1000):
        found = [r.name for r in find_runs(sweep, where=text, first=first)]
        assert found == [f"case {r.case}, sample {r.sample}" for r in runs[:first].itertuples()]
        assert found


# -- what is not there, or not as it was ---------------------------------------------------------


def test_a_stored_number_that_is_not_what_comes_out_is_told(sweep, tmp_path):
    (run,) = find_runs(sweep, where='type == "R"')
    one = SimpleNamespace(**run.values)

    def change(table):
        keys = zip(table["case"].to_pylist(), table["sample"].to_pylist(), strict=True)
        t_r = zip(keys, table["t_r"].to_pylist(), strict=True)
        key = (one.case, one.sample)
        return replaced(table, "t_r", [np.nextafter(t, np.inf) if k == key else t for k, t in t_r])

    output = edited(sweep, tmp_path / "out", change)
    result = invoke("replay", output, "--case", one.case, "--sample", one.sample)
    assert (result.exit_code, result.stdout) == (1, "")
    words = f"{run.name} comes out otherwise than stored, in t_r;"
    assert words in result.stderr
    with pytest.raises(rs.OutputError, match=words):
        rs.replay(output, one.case, one.sample)
    gone = edited(sweep, tmp_path / "gone", lambda table: table[:0])
    with pytest.raises(rs.OutputError, match="is not stored yet"):
        rs.replay(gone, one.case, one.sample)


@pytest.mark.parametrize("model", ["gh", pytest.param("reduced", marks=pytest.mark.slow)])
def test_other_models_are_replayed_too(tmp_path, model):
    output, table = tmp_path / "out", tmp_path / "run.csv"
    result = run("gh.yaml", output, f"model={model}", "spin.n_i=[0.1]", "record=[]")
    assert result.exit_code == 0
    t_r = float(rows(output)["t_r"].iloc[0])
    result = invoke("replay", output, "--case", 0, "--sample", 0, "--points", 3, "--output", table)
    assert result.exit_code == 0
    assert f"t_r {t_r!r} and type R" in result.stderr
    assert pcsv.read_csv(table).num_rows == 3


@pytest.mark.parametrize("model", [FULL, ELLIPSOID, *FRICTION.values()], ids=lambda m: m.name)
def test_channels_are_what_the_equations_say(model):
    """The formulas for arrays, in vectors, against the scalar functions of the kernels."""
    y = np.random.default_rng(1).uniform(-0.3, 0.3, (model.n_state, 9))
    body = full.constants(13.04, 1.522, 12.28, 0.6429, 0.036, -0.03)
    constants = np.append(body, [1 / 3, 0.02, 0.03, 1e-4])[: model.n_constants]
    constants[6:7] *= model.touch is stone.ellipsoid
    constants[8:9] *= "rolling" in model.name
    functions = model.spin, model.energy, model.contact
    arguments = (), constants, constants
    n, kept, force = (
        np.array([function(*state, *more) for state in y.T])
        for function, more in zip(functions, arguments, strict=True)
    )
    work = y[5] if len(y) > 5 else 0
    np.testing.assert_allclose(channels.spin(y), n, rtol=1e-13, atol=1e-15)
    np.testing.assert_allclose(channels.energy(y, constants), kept + work, rtol=1e-13)
    np.testing.assert_allclose(channels.contact_force(y, constants), force.T, rtol=1e-10)


def test_rows_may_begin_late(sweep, tmp_path):
    which = ["replay", sweep, "--case", 0, "--sample", 1, "--t-end", 30]
    whole = invoke(*which, "--dt", 0.5).stdout.splitlines()
    late = invoke(*which, "--dt", 0.5, "--from-time", 20)
    assert late.exit_code == 0
    assert late.stdout.splitlines() == [whole[0], *whole[41:]]
    steps = invoke(*which, "--steps").stdout.splitlines()
    kept = [line for line in steps[1:] if float(line.split(",")[0]) >= 20]
    assert 0 < len(kept) < len(steps) - 1
    assert invoke(*which, "--steps", "--from-time", 20).stdout.splitlines() == [steps[0], *kept]
    few = invoke(*which, "--points", 3, "--from-time", 20).stdout.splitlines()
    assert [line.split(",")[0] for line in few[1:]] == ["20", "25", "30"]
    figure = tmp_path / "late.svg"
    assert invoke(*which, "--from-time", 20, "--figure", figure).exit_code == 0
    for bad in (-1, 30, "nan"):
        refused = invoke(*which, "--from-time", bad)
        assert_refused(refused, 2, f"from_time {bad}")


def test_a_fast_oscillation_is_drawn_as_an_envelope():
    """Both edges hold the extremes of their stretches, and little else is drawn."""
    t = np.linspace(0, 1000, 100_001)
    axis = style.new_figure(5, 3).subplots()
    style.curve(axis, t, np.exp(-t / 500) * np.sin(2 * np.pi * t))
    low, high = (line.get_xydata().T for line in axis.lines)
    np.testing.assert_allclose(high[1], np.exp(-high[0] / 500), atol=0.01)
    np.testing.assert_allclose(low[1], -np.exp(-low[0] / 500), atol=0.01)
    assert len(axis.collections) == 1
    assert len(high[0]) < 1000
