"""Where bodies come from: the random numbers, the four sources, and what they refuse."""

from __future__ import annotations

import math
import tempfile
from decimal import Decimal
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy import stats

import rattlesweep as rs
from rattlesweep.errors import ConfigError
from rattlesweep.physics import theory
from rattlesweep.physics.body import PARAMETERS
from rattlesweep.sweeps.cases.launches import prepare
from rattlesweep.sweeps.cases.philox import uniforms
from rattlesweep.sweeps.cases.plan import make_plan
from rattlesweep.sweeps.cases.sampler import draw_bodies
from rattlesweep.sweeps.cases.sources import CHUNK
from rattlesweep.sweeps.config.load import parse_config
from rattlesweep.sweeps.inspect.content_hash import content_hash

SPIN = {"n_i": -0.1, "omega_xy0": 0.01}
TABLE_I = {
    "gamma": [5, 15], "f_sd": [0.05, 0.15], "theta": [0.6, 0.95], "phi": [0.01, 0.1],
    "minus_xi_deg": [0, 6],
}  # fmt: skip
RANGES = np.array(list(TABLE_I.values()), dtype=float)
GH = "13.04,1.522,12.28,0.6429,0.036,-0.03"
HEAD = ",".join(PARAMETERS)


def plan(bodies: dict[str, Any], spin: dict[str, Any] | None = SPIN, **others: Any) -> Any:
    data = {"bodies": bodies, **others}
    return make_plan(parse_config(data if spin is None else {**data, "spin": spin}))


def columns(bodies: Any) -> np.ndarray:
    return np.array([getattr(bodies, name) for name in PARAMETERS])


def table(directory: Path, text: str, name: str = "b.csv", spin: Any = SPIN) -> Any:
    path = directory / name
    path.write_text(text, encoding="utf-8")
    return plan({"source": "table", "path": str(path)}, spin)


def refusal(call: Any) -> str:
    with pytest.raises(ConfigError) as caught:
        call()
    assert len(caught.value.messages) == 1
    line = caught.value.messages[0]
    assert "\n" not in line
    assert len(line) < 500
    return line


# -- random numbers ----------------------------------------------------------------------------

words = st.integers(0, 2**63 - 1) | st.integers(0, 3) | st.integers(2**63 - 3, 2**63 - 1)


@settings(max_examples=200, deadline=None)
@given(words, st.integers(0, 2**31), words, st.integers(0, 2**61) | st.integers(0, 3))
@example(0, 0, 0, 0)
@example(2**63 - 1, 2**31, 2**63 - 1, 2**61)
def test_the_bits_are_those_of_numpys_philox(seed, group, sample, draw):
    # As one 256-bit integer: a list with numbers above 2^63 would become floats.
    key, counter = seed + (group << 64), 2 * draw + (sample << 64)
    generator = np.random.Generator(np.random.Philox(key=key, counter=counter))
    assert uniforms(seed, group, sample, draw) == tuple(generator.random(8))


def test_draws_fill_the_ranges_uniformly_and_independently():
    n = 20_000
    drawn, _, _ = draw_bodies(2017, 0, np.arange(n), RANGES)
    gamma, f_sd, theta, phi, xi, alpha, beta = drawn
    minus_xi_deg = -np.degrees(xi)
    unit = []
    for values, (low, high) in zip((gamma, f_sd, theta, phi, minus_xi_deg), RANGES, strict=True):
        assert values.min() >= low
        assert values.max() <= high * (1 + 1e-15)
        unit.append((values - low) / (high - low))
        assert unit[-1].min() < 1e-3
        assert unit[-1].max() > 1 - 1e-3
        assert stats.kstest(unit[-1], "uniform").pvalue > 1e-3
    assert np.abs(np.corrcoef(unit) - np.eye(5)).max() < 4 / math.sqrt(n)
    # The draw 1 - u lies in (0, 1]: the angle is never zero.
    assert (xi < 0).all()
    assert np.array_equal(alpha, (1 - f_sd) * gamma + 1)
    assert np.array_equal(beta, f_sd * gamma + 1)


# -- shell-dumbbell bodies ---------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "values"), [("K_r", [0.0041, 0.03, 0.1]), ("K_p", [0.05, 0.45, 2.34])]
)
def test_targets_are_met(name, values):
    tolerance = 2e-3
    bodies = {"source": "sd", "samples": 100, "target": {name: values, "rel_tol": tolerance}}
    made = plan(bodies)
    for group, value in enumerate(values):
        b = made.source.bodies(group, np.arange(100))
        found = getattr(theory.modes(b.alpha, b.beta, b.theta, b.phi, b.xi), name)
        assert (np.abs(found - value) <= tolerance * value * (1 + 1e-12)).all()
        assert np.ptp(found) > tolerance * value / 2
        for values_, (low, high) in zip((b.gamma, b.f_sd, b.theta, b.phi), RANGES, strict=False):
            assert values_.min() >= low
            assert values_.max() <= high


def test_cases_of_one_target_share_their_bodies():
    target = {"K_r": [0.03, 0.1], "rel_tol": 0.05}
    spin = {"n_i": [-0.1, -0.5], "omega_xy0": [0.001, 0.1]}
    found = rs_runs({"source": "sd", "samples": 7, "target": target}, spin)
    cases = [group[list(PARAMETERS)].to_numpy() for _, group in found.groupby("case")]
    assert len(cases) == 8
    for first in (0, 4):
        for other in range(first + 1, first + 4):
            assert np.array_equal(cases[first], cases[other])
    assert not np.isin(cases[0], cases[4]).any()
    # Targets first, then spins, then oscillations: the order of the config.
    order = found.groupby("case")[["n_i", "omega_xy0"]].first().to_numpy().tolist()
    assert order == [[-0.1, 0.001], [-0.1, 0.1], [-0.5, 0.001], [-0.5, 0.1]] * 2


def rs_runs(bodies: dict[str, Any], spin: Any = SPIN, **others: Any) -> pd.DataFrame:
    """The rows of a sweep that integrates nothing."""
    data = {"bodies": bodies, "spin": spin, "model": "gh", **others}
    with tempfile.TemporaryDirectory() as directory:
        return rs.sweep(data, output=Path(directory) / "out").runs


@pytest.mark.parametrize("target", [None, {"K_r": [0.03, 0.1], "rel_tol": 0.05}])
def test_a_body_depends_on_seed_group_and_sample_alone(target):
    n = CHUNK + 50
    bodies = {"source": "sd", "samples": n} | ({"target": target} if target else {})
    groups = 2 if target else 1
    whole = [columns(plan(bodies, seed=3).source.bodies(g, np.arange(n))) for g in range(groups)]
    rng = np.random.default_rng(1)
    for group in range(groups):
        fresh = plan(bodies, seed=3)
        for picks in (np.array([n - 1]), np.array([0]), np.sort(rng.choice(n, 200, replace=False))):
            assert np.array_equal(
                columns(fresh.source.bodies(group, picks)), whole[group][:, picks]
            )
    more = plan({**bodies, "samples": 2 * n}, seed=3).source.bodies(0, np.arange(n))
    assert np.array_equal(columns(more), whole[0])
    other = plan({**bodies, "samples": 20}, seed=4).source.bodies(0, np.arange(20))
    assert not np.isin(columns(other), whole[0]).any()


def test_a_body_does_not_depend_on_threads():
    one, *others = (
        draw_bodies(1, 2, np.arange(301), RANGES, 2, 0.05, 0.01, 10**6, threads=threads)
        for threads in (1, 2, 3)
    )
    for other in others:
        assert [part.tobytes() for part in other] == [part.tobytes() for part in one]


def test_samples_come_in_the_order_asked_for_from_any_chunk():
    """A block may end one case and begin the next, and `verify` asks for runs here and there."""
    samples = 2 * CHUNK + 100
    bodies = {"source": "sd", "samples": samples, "target": {"K_r": 0.05, "rel_tol": 0.3}}
    source = plan(bodies).source
    every = source.bodies(0, np.arange(samples))
    asked = np.random.default_rng(5).choice(samples, 500)
    some = source.bodies(0, asked)
    for name in ("alpha", "beta", "gamma", "theta", "phi", "xi", "f_sd"):
        assert getattr(some, name).tobytes() == getattr(every, name)[asked].tobytes()
    small = bodies | {"samples": 33, "target": {"K_r": [0.03, 0.1], "rel_tol": 0.05}}
    frames = [
        rs_runs(data, {"n_i": [-0.1, 0.2], "omega_xy0": 0.01}, block_size=size)
        for data, sizes in ((bodies, (1000, samples + 4321)), (small, (1, 7, 10_000)))
        for size in sizes
    ]
    for one, other in ((0, 1), (2, 3), (2, 4)):
        pd.testing.assert_frame_equal(frames[one], frames[other], check_exact=True)


@pytest.mark.parametrize(("name", "value"), [("K_r", 5.0), ("K_p", 1e-9)])
def test_an_impossible_target_says_how_close_the_ranges_get(name, value):
    bodies = {"source": "sd", "samples": 10**6, "target": {name: [0.1, value], "max_draws": 20_000}}
    line = refusal(plan(bodies).source.check_targets)
    assert line.startswith(f"bodies.target.{name}: {value:g} was not met to 0.001 in 20000 draws")
    nearest = float(line.split("the nearest being ")[1].split(";")[0])
    drawn = draw_bodies(0, 1, np.arange(200_000), RANGES)[0]
    all_ = getattr(theory.modes(drawn[5], drawn[6], drawn[2], drawn[3], drawn[4]), name)
    # The nearest of 20,000 draws of one sample: of the order of the nearest of all.
    assert abs(math.log(nearest / (all_.max() if value > 1 else all_.min()))) < 3
    assert min(all_) < nearest < max(all_) * 1.5


# -- presets and grids -------------------------------------------------------------------------


def test_a_preset_is_one_body_with_what_was_replaced():
    gh = rs.Rattleback.gh()
    made = plan({"source": "preset", "name": "GH", "overrides": {"theta": 0.82, "xi_deg": -2}})
    b = made.source.bodies(0, np.array([0]))
    assert made.samples == 1
    assert np.isnan(b.f_sd).all()
    expected = [gh.alpha, gh.beta, gh.gamma, 0.82, gh.phi, math.radians(-2)]
    assert columns(b)[:, 0].tolist() == expected


@pytest.mark.parametrize(
    ("overrides", "words"),
    [
        ({"theta": 1.2}, "theta: 1.2 is out of range; it must be below 1"),
        ({"theta": 0.03}, "phi 0.036 is not below theta 0.03"),
        ({"phi": 0.7}, "phi 0.7 is not below theta 0.6429"),
        ({"beta": 14}, "alpha 13.04 is not above beta 14"),
        ({"alpha": 20}, "no body has this inertia: I_xx = alpha - 1 = 19 exceeds"),
        ({"gamma": 13}, "no body has this inertia: I_zz = gamma = 13 exceeds"),
        ({"xi": 0.1}, "xi: 0.1 is out of range; it must be below 0"),
    ],
)
def test_overrides_out_of_range_are_refused(overrides, words):
    line = refusal(lambda: plan({"source": "preset", "name": "GH", "overrides": overrides}))
    assert line.startswith("bodies.overrides")
    assert words in line


def test_a_grid_goes_through_its_axes_the_first_one_slowest():
    axes = {"theta": {"linspace": [0.6, 0.9, 4]}, "phi": [0.02, 0.036], "xi_deg": [-1, -3]}
    made = plan({"source": "grid", "base": {"preset": "GH"}, "axes": axes})
    assert made.samples == 16
    b = made.source.bodies(0, np.arange(16))
    theta, phi, xi = np.meshgrid(
        [0.6, 0.7, 0.8, 0.9], [0.02, 0.036], np.radians([-1, -3]), indexing="ij"
    )
    np.testing.assert_allclose(b.theta, theta.ravel(), rtol=1e-15)
    assert np.array_equal(b.phi, phi.ravel())
    assert np.array_equal(b.xi, xi.ravel())
    assert (b.alpha == 13.04).all()
    assert np.array_equal(columns(made.source.bodies(0, np.array([3, 9]))), columns(b)[:, [3, 9]])


def test_a_grid_over_a_shell_dumbbell_body_remakes_its_inertia():
    base = {"gamma": 10, "f_sd": 0.1, "theta": 0.7, "phi": 0.05, "xi_deg": -3}
    axes = {"gamma": [8, 10], "f_sd": [0.1, 0.2], "minus_xi_deg": {"logspace": [0.01, 1, 3]}}
    b = plan({"source": "grid", "base": base, "axes": axes}).source.bodies(0, np.arange(12))
    # The axes in the order in which a body lists its parameters.
    assert b.gamma.tolist() == [8.0] * 6 + [10.0] * 6
    assert b.f_sd.tolist() == ([0.1] * 3 + [0.2] * 3) * 2
    np.testing.assert_allclose(-np.degrees(b.xi), [0.01, 0.1, 1] * 4, rtol=1e-14)
    assert np.array_equal(b.beta, b.f_sd * b.gamma + 1)
    assert np.array_equal(b.alpha, (1 - b.f_sd) * b.gamma + 1)


@pytest.mark.parametrize(
    ("axes", "corner", "words"),
    [
        # gamma 13 exceeds I_xx + I_yy = 12.562 of GH's alpha and beta, but only there.
        ({"theta": [0.7, 0.8], "gamma": [12, 12.28, 13]},
         "bodies.axes: at alpha 13.04, beta 1.522, gamma 13, theta 0.7, phi 0.036",
         "I_zz = gamma = 13 exceeds I_xx + I_yy = 12.562"),
        ({"phi": [0.02, 0.7]}, "bodies.axes: at alpha 13.04", "phi 0.7 is not below theta 0.6429"),
    ],
)  # fmt: skip
def test_an_impossible_corner_of_a_grid_is_named(axes, corner, words):
    line = refusal(lambda: plan({"source": "grid", "base": {"preset": "GH"}, "axes": axes}))
    assert line.startswith(corner)
    assert words in line


# -- tables ------------------------------------------------------------------------------------


def test_csv_and_parquet_tables_give_the_same_bodies(tmp_path):
    text = f"{HEAD},comment\n{GH},first\n9.3,2.1,9.4,0.81,0.07,-0.02,second\n"
    made = table(tmp_path, text)
    assert made.samples == 2
    b = made.source.bodies(0, np.arange(2))
    assert columns(b)[:, 0].tolist() == [float(x) for x in GH.split(",")]
    pd.read_csv(tmp_path / "b.csv").to_parquet(tmp_path / "b.parquet")
    path = str(tmp_path / "b.parquet")
    again = plan({"source": "table", "path": path}).source.bodies(0, np.arange(2))
    assert np.array_equal(columns(again), columns(b))


def test_a_table_is_found_beside_its_config(tmp_path, monkeypatch):
    (tmp_path / "b.csv").write_text(f"{HEAD}\n{GH}\n")
    (tmp_path / "c.yaml").write_text(
        "bodies: {source: table, path: b.csv}\nspin: {n_i: 0.1, omega_xy0: 0.01}\nmodel: gh\n"
    )
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    monkeypatch.chdir(elsewhere)
    assert len(rs.sweep(tmp_path / "c.yaml", output=tmp_path / "out").runs) == 1


def test_launches_and_horizons_of_a_table_replace_those_of_the_config(tmp_path):
    text = f"{HEAD},n_i,omega_xy0,t_end\n{GH},0.1,0.01,30\n{GH},-0.2,0.001,40\n"
    made = table(tmp_path, text, spin=None)
    path = str(tmp_path / "b.csv")
    data = {"bodies": {"source": "table", "path": path}, "integrator": {"tol": 1e-6}}
    frame = rs.sweep(data, output=tmp_path / "out").runs
    assert len(made.cases) == 1
    assert frame.n_i.tolist() == [0.1, -0.2]
    assert frame.omega_xy0.tolist() == [0.01, 0.001]
    assert frame.t_end.tolist() == [30, 40]
    summary = rs.load(tmp_path / "out").summary
    assert summary[["n_i", "omega_xy0"]].isna().all(axis=None)


STATE = f"{HEAD},omega_x,omega_y,omega_z,u_x,u_y,u_z"
BAD_TABLES = {
    "missing column": ("alpha,beta,gamma,theta,phi\n1,2,3,4,5\n", "the column xi is missing"),
    "text cell": (f"{HEAD}\n{GH}\n13,1.5,12,abc,0.1,-0.1\n", "row 2: theta is 'abc'; a finite"),
    "empty cell": (f"{HEAD}\n{GH}\n13,1.5,12,,0.1,-0.1\n", "row 2: theta is empty; a finite"),
    "too large": (f"{HEAD}\n13,1.5,1e999,0.5,0.1,-0.1\n", "row 1: gamma is '1e999'; a finite"),
    "impossible body": (f"{HEAD}\n{GH}\n{GH}\n13,1.5,12.3,1.2,0.1,-0.1\n", "row 3: theta is 1.2;"),
    "no skew": (f"{HEAD}\n13,1.5,12.3,0.5,0.2,0\n", "row 1: xi is 0 rad"),
    "n_i alone": (f"{HEAD},n_i\n{GH},0.1\n", "n_i stands alone; give both"),
    "no u": (f"{HEAD},omega_x,omega_y,omega_z\n{GH},0,0,1\n", "the column u_x is missing; a full"),
    "u too long": (
        f"{STATE}\n{GH},0,0,1,0,0.5,-1\n",
        "row 1: u: its length is 1.11803; give a unit",
    ),
    "upside down": (f"{STATE}\n{GH},0,0,1,0,0,1\n", "row 1: u: u_z is 1; it must be negative"),
    "at rest": (
        f"{STATE}\n{GH},0,0,0,0,0,-1\n",
        "row 1: the body stands upright and at rest; give",
    ),
    "another spin": (
        f"{STATE},n_i,omega_xy0\n{GH},0,0,1,0,0,-1,1,0.1\n",
        "row 1: n_i is 1, and the spin of the full state -1; leave n_i and omega_xy0",
    ),
    "omega below 0": (f"{HEAD},n_i,omega_xy0\n{GH},1,-1\n", "row 1: omega_xy0 is -1; it must be"),
    "horizon of 0": (f"{HEAD},t_end\n{GH},0\n", "row 1: t_end is 0; it must be positive"),
    "empty launch": (f"{HEAD},n_i,omega_xy0\n{GH},,0.1\n", "row 1: n_i is empty; a finite"),
    "repeated": (f"{HEAD},theta\n{GH},0.7\n", "there are 2 columns theta; keep one of them"),
    "a cell more in each row": (f"{HEAD}\n{GH},\n{GH},\n", "cannot be read as a table ("),
    "no rows": (f"{HEAD}\n", "the table has no rows; give at least one body"),
    "too many cells": (f"{HEAD}\n{GH}\n{GH},1,2,3\n", "cannot be read as a table ("),
}


@pytest.mark.parametrize("name", BAD_TABLES)
def test_a_bad_table_is_told_by_its_row(name, tmp_path):
    text, words = BAD_TABLES[name]
    line = refusal(lambda: table(tmp_path, text))
    assert line.startswith("bodies.path: ")
    assert words in line


NO_TABLES = {
    "b.parquet": b"PAR1 this is not one PAR1", "latin.csv": b"alpha,\xe9\n1,2\n",
    "zero.csv": b"\0" * 100, "notes.docx": b"PK\x03\x04" + bytes(range(256)), "empty": None,
}  # fmt: skip


@pytest.mark.parametrize("name", NO_TABLES)
def test_files_that_are_no_tables(name, tmp_path):
    content = NO_TABLES[name]
    (tmp_path / name).mkdir() if content is None else (tmp_path / name).write_bytes(content)
    line = refusal(lambda: plan({"source": "table", "path": str(tmp_path / name)}))
    assert line.startswith("bodies.path: ")
    assert name in line


def test_wrong_types_inside_parquet_are_told(tmp_path):
    frame = pd.DataFrame(
        [[13.04, 1.522, 12.28, 0.6429, 0.036, -0.03]] * 3, columns=list(PARAMETERS)
    )
    path = tmp_path / "b.parquet"
    frame.assign(theta=["0.5", "x", "0.6"]).to_parquet(path)
    line = refusal(lambda: plan({"source": "table", "path": str(path)}))
    assert "row 2: theta is 'x'; a finite number is needed" in line
    frame.assign(theta=[0.6, None, 0.6]).to_parquet(path)
    line = refusal(lambda: plan({"source": "table", "path": str(path)}))
    assert "row 2: theta is empty" in line
    frame.assign(theta=[[1.0], [2.0], [3.0]]).to_parquet(path)
    assert "theta" in refusal(lambda: plan({"source": "table", "path": str(path)}))
    values: dict[str, Any] = {
        "timestamp[us]": [pd.Timestamp("2020-01-01")] * 3, "binary": [b"0.5"] * 3,
        "bool": [True, None, True], "duration[ns]": [pd.Timedelta(1)] * 3,
    }  # fmt: skip
    for kind, column in values.items():
        frame.assign(alpha=column).to_parquet(path)
        line = refusal(lambda: plan({"source": "table", "path": str(path)}))
        assert f": the column alpha is of type {kind}; numbers are wanted" in line
    # Any type of numbers is good, and columns that are not read may be of any type.
    good = frame.assign(alpha=[Decimal("13.5")] * 3, beta=np.float32(1.5), note=[True] * 3)
    good.assign(gamma=["12"] * 3).to_parquet(path)
    bodies = plan({"source": "table", "path": str(path)}).source.bodies(0, np.arange(3))
    assert columns(bodies)[:3].T.tolist() == [[13.5, 1.5, 12.0]] * 3
    table_ = pa.table([pa.array([0.5])] * 7, names=[*PARAMETERS, "theta"])
    pq.write_table(table_, path)
    line = refusal(lambda: plan({"source": "table", "path": str(path)}))
    assert "there are 2 columns theta; keep one of them" in line


def test_a_table_without_launch_needs_a_spin(tmp_path):
    line = refusal(lambda: table(tmp_path, f"{HEAD}\n{GH}\n", spin=None))
    assert line.startswith("spin: missing; the table has no columns n_i and omega_xy0")


@pytest.mark.parametrize("psi", ["relevant", 30.0])
def test_an_output_table_is_a_valid_input_and_gives_the_same_results(psi, tmp_path):
    """Runs that reversed keep the config's horizon, and the others end where they ended."""
    data = {
        "bodies": {"source": "sd", "samples": 6, "target": {"K_r": [0.03, 0.1], "rel_tol": 0.05}},
        "spin": {"n_i": [-0.4, 0.1], "omega_xy0": 0.01, "psi": psi},
        "horizon": {"t_rgh": 3},
    }
    first = rs.sweep(data, output=tmp_path / "first").runs
    assert 0 < first.t_r.notna().sum() < len(first)
    assert (first.t_end[first.t_r.notna()] == first.t_r.dropna()).all()
    block = tmp_path / "first" / "runs" / "block-000000.parquet"
    assert pq.ParquetFile(block).metadata.num_rows == 24
    for k, path in enumerate((block.parent, block)):
        again = {"bodies": {"source": "table", "path": str(path)}, "horizon": {"t_rgh": 3}}
        other = rs.sweep(again, output=tmp_path / f"again{k}").runs
        same = [c for c in first.columns if c not in ("case", "sample")]
        pd.testing.assert_frame_equal(first[same], other[same], check_exact=True)
    assert content_hash(tmp_path / "again0") == content_hash(tmp_path / "again1")
    # With a shorter horizon in the config, only rows that have a t_r are cut.
    short = {"bodies": {"source": "table", "path": str(block)}, "horizon": {"t": 10}}
    cut = rs.sweep(short, output=tmp_path / "short").runs
    had = first.t_r.notna().to_numpy()
    assert (cut.t_end[had] <= 10).all()
    assert np.array_equal(cut.t_end[~had], first.t_end[~had])


def test_runs_in_any_order_get_their_own_bodies():
    made = plan({"source": "sd", "samples": 4, "target": {"K_r": [0.01, 0.1], "rel_tol": 0.1}})
    case, sample = np.array([0, 0, 1, 1]), np.array([0, 3, 0, 3])
    order = [2, 1, 3, 0]
    whole, mixed = prepare(made, case, sample), prepare(made, case[order], sample[order])
    assert np.array_equal(columns(mixed.bodies), columns(whole.bodies)[:, order])
    assert np.array_equal(mixed.gh.t_rgh, whole.gh.t_rgh[order])
