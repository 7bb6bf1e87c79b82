"""Sources of bodies: random numbers, draws, grids and tables, and their messages."""

from __future__ import annotations

import math
import os
import pickle
from typing import Any

import numpy as np
import pandas as pd
import polars as pl
import pyarrow as pa
import pytest
import sweeping
from hypothesis import example, given, settings
from hypothesis import strategies as st
from numba import njit
from scipy.stats import qmc
from sweeping import HEAD, ROW, rows

import rattlesweep as rs
from rattlesweep.config.body_sources import Target
from rattlesweep.design import tables
from rattlesweep.design.bodies import sources
from rattlesweep.design.bodies.sources import DRAWN_TOGETHER, draw_points, uniforms
from rattlesweep.design.tables import read_table
from rattlesweep.physics import theory
from rattlesweep.physics.body import PARAMETERS
from rattlesweep.words.errors import ConfigError

SPIN = {"n_i": -0.1, "omega_xy0": 0.01}
TABLE_I = {
    "gamma": [5, 15],
    "f_sd": [0.05, 0.15],
    "theta": [0.6, 0.95],
    "phi": [0.01, 0.1],
    "minus_xi_deg": [0, 6],
}
RANGES = np.array(list(TABLE_I.values()), dtype=float)
GRID = {"source": "grid", "base": {"preset": "GH"}}


def plan(bodies: dict[str, Any], **others: Any) -> Any:
    return sweeping.plan_of({"bodies": bodies, "spin": SPIN, **others})


def drawn(samples: int = 0, **bodies: Any) -> dict[str, Any]:
    return {"source": "sd", "samples": samples, **bodies}


def bodies_of(plan: Any, target: float = math.nan, samples: Any = None) -> np.ndarray:
    """Return the parameters of a plan's bodies, of the shape (6, samples)."""
    some = np.arange(plan.samples) if samples is None else np.asarray(samples)
    bodies = plan.source.bodies(target, some)
    return np.array([getattr(bodies, name) for name in PARAMETERS])


def refusal(bodies: dict[str, Any]) -> str:
    with pytest.raises(ConfigError) as caught:
        plan(bodies).source.check_targets()
    (line,) = caught.value.messages
    assert "\n" not in line
    assert len(line) < 500
    return line


numbers = (
    st.integers(0, 2**63 - 1) | st.integers(0, 3) | st.integers(2**63 - 3, 2**63 - 1)
)
signed = st.integers(-(2**63), 2**63 - 1)


compiled = njit(uniforms)


@settings(max_examples=200, deadline=None)
@given(numbers, signed, numbers, st.integers(0, 2**61) | st.integers(0, 3))
@example(0, 0, 0, 0)
@example(2**63 - 1, 0, 2**63 - 1, 0)
@example(3, 0, 2, 0)
@example(2**63 - 1, -(2**63), 2**63 - 1, 2**61)
def test_the_bits_are_those_of_numpys_philox(seed, word, sample, draw):
    # As one 256-bit integer: a list with numbers above 2^63 would become floats.
    key = seed + (word % 2**64 << 64)
    counter = 2 * draw + (sample << 64)
    generator = np.random.Generator(np.random.Philox(key=key, counter=counter))
    expected = generator.random(8)
    assert compiled(seed, word, sample, draw) == tuple(expected)
    if word == draw == 0:
        # The first draw without a target needs no kernel.
        assert (draw_points(seed, np.array([sample]))[:, 0] == expected[:6]).all()


def sobol(samples: Any, seed: int = 7) -> np.ndarray:
    """Return the points of the unit cube from which bodies of a Sobol' sequence are
    design.
    """
    b = plan(drawn(20_000, draw="sobol"), seed=seed).source.bodies(
        math.nan, np.asarray(samples)
    )
    low, high = RANGES.T[:, :, None]
    points = (np.stack([b.gamma, b.f_sd, b.theta, b.phi, -np.degrees(b.xi)]) - low) / (
        high - low
    )
    points[4] = 1 - points[4]
    return points


def test_a_sequence_is_scipys_and_fills_every_cell_equally():
    theirs = qmc.Sobol(5, rng=np.random.default_rng((7, 0))).random(64).T
    np.testing.assert_allclose(sobol(range(64)), theirs, atol=1e-12)
    # Unlike random points, 2^k of them have one in each of 2^k equal parts of every
    # range.
    cells = np.sort(np.floor(256 * sobol(range(256))), axis=1)
    assert np.array_equal(cells, np.tile(np.arange(256), (5, 1)))


@pytest.mark.parametrize(
    ("name", "values"), [("K_r", [0.0041, 0.1]), ("K_p", [0.05, 2.34])]
)
def test_targets_are_met(name, values):
    design = plan(drawn(100, target={name: values, "rel_tol": 2e-3}))
    for value in values:
        b = design.source.bodies(value, np.arange(100))
        reached = getattr(theory.modes(b.alpha, b.beta, b.theta, b.phi, b.xi), name)
        assert (np.abs(reached - value) <= 2e-3 * value * (1 + 1e-12)).all()
        assert np.ptp(reached) > 1e-3 * value
        for values_, (low, high) in zip(
            (b.gamma, b.f_sd, b.theta, b.phi), RANGES, strict=False
        ):
            assert low <= values_.min() <= values_.max() <= high


@pytest.mark.parametrize(
    "own", [{}, {"target": {"K_r": [0.03, 0.1], "rel_tol": 0.05}}, {"draw": "sobol"}]
)
def test_a_body_depends_on_seed_target_and_sample_alone(own):
    """It depends neither on the chunk in which it is drawn nor on the order of the
    samples.
    """
    n = DRAWN_TOGETHER + 50
    config = drawn(n, **own)
    rng = np.random.default_rng(1)
    targets = own.get("target", {"K_r": [math.nan]})["K_r"]
    for value in targets:
        fresh = plan(config, seed=3)
        whole = bodies_of(plan(config, seed=3), value)
        fresh = pickle.loads(pickle.dumps(fresh))
        for picks in ([n - 1], [0], rng.choice(n, 200)):
            assert np.array_equal(bodies_of(fresh, value, picks), whole[:, picks])
    # More samples, and more targets before or between them, do not change the bodies.
    wider = (
        {"target": own["target"] | {"K_r": [0.02, 0.03, 0.05, 0.1]}}
        if "target" in own
        else {}
    )
    more = bodies_of(
        plan(config | wider | {"samples": 2 * n}, seed=3), value, np.arange(n)
    )
    assert np.array_equal(more, whole)
    assert not np.isin(
        bodies_of(plan(config | {"samples": 20}, seed=4), value), whole
    ).any()


@pytest.mark.parametrize(
    "semi_axis", [{}, {"c": [1.5, 4]}], ids=["seven", "eight with c"]
)
def test_samples_of_a_group_differ_in_one_parameter_each(semi_axis):
    """Saltelli's design: two points, and the first with each parameter of the second in
    turn.
    """
    names = ["gamma", "f_sd", "theta", "phi", "xi", *semi_axis]
    n = len(names)
    group = n + 2
    design = plan(drawn(group * 512, draw="saltelli", **semi_axis))
    b = design.source.bodies(math.nan, np.arange(group * 40))
    columns = vars(b) | b.further
    values = np.array([columns[name] for name in names]).reshape(n, 40, group)
    first = values[:, :, 0]
    second = values[:, :, 1]
    mixed = values[:, :, 2:]
    assert (first != second).all()
    for k in range(n):
        for p in range(n):
            source = second if p == k else first
            assert np.array_equal(mixed[p, :, k], source[p])


def test_a_body_does_not_depend_on_threads(monkeypatch):
    target = Target(K_r=[0.05], rel_tol=0.01)
    drawn_by = set()
    for threads in (1, 2, 3):
        monkeypatch.setattr(
            sources, "available_threads", lambda threads=threads: threads
        )
        drawn_by.add(draw_points(1, np.arange(301), RANGES, target, 0.05).tobytes())
    assert len(drawn_by) == 1


def test_an_impossible_target_is_refused():
    line = refusal(drawn(10**6, target={"K_p": [0.1, 1e-9], "max_draws": 20_000}))
    assert line.startswith(
        "bodies.target.K_p: 1e-09 was not met to 0.001 in 20000 draws"
    )


@pytest.mark.parametrize(("name", "value"), [("K_r", 0.05), ("K_p", 0.4)])
def test_a_target_is_refused_where_the_sampler_would_give_up(name, value):
    """The check draws by NumPy, the sampler in a kernel."""
    outcomes = set()
    for seed in range(12):
        for draws in (1, 2, 4, 8, 16, 32, 64):
            target = {name: [value], "rel_tol": 0.05, "max_draws": draws}
            source = plan(drawn(1, target=target), seed=seed).source
            by_check, by_sampler = None, None
            try:
                source.check_targets()
            except ConfigError as error:
                by_check = str(error)
            try:
                source.bodies(value, np.arange(1))
            except ConfigError as error:
                by_sampler = str(error)
            assert by_check == by_sampler
            outcomes.add(by_check is None)
    assert outcomes == {True, False}


def test_the_first_axis_of_a_grid_varies_slowest():
    axes = {
        "theta": {"linspace": [0.6, 0.9, 4]},
        "phi": [0.02, 0.036],
        "xi_deg": [-1, -3],
    }
    design = plan(GRID | {"axes": axes})
    b = bodies_of(design)
    grid = np.meshgrid(
        [0.6, 0.7, 0.8, 0.9], [0.02, 0.036], np.radians([-1, -3]), indexing="ij"
    )
    np.testing.assert_allclose(b[3:], [values.ravel() for values in grid], rtol=1e-15)
    assert (b[0] == 13.04).all()
    assert np.array_equal(bodies_of(design, samples=[3, 9]), b[:, [3, 9]])


def table(directory: Any, text: str) -> dict[str, Any]:
    (directory / "b.csv").write_text(text, encoding="utf-8")
    return {"source": "table", "path": str(directory / "b.csv")}


def test_tables_are_csv_or_parquet_and_found_beside_their_config(tmp_path, monkeypatch):
    source = table(
        tmp_path, f"{HEAD},comment\n{ROW},first\n9.3,2.1,9.4,0.81,0.07,-0.02,second\n"
    )
    b = bodies_of(plan(source))
    assert b.T.tolist() == [
        [float(x) for x in ROW.split(",")],
        [9.3, 2.1, 9.4, 0.81, 0.07, -0.02],
    ]
    path = tmp_path / "b.parquet"
    pd.read_csv(tmp_path / "b.csv").to_parquet(path)
    assert np.array_equal(bodies_of(plan({"source": "table", "path": str(path)})), b)
    (tmp_path / "c.yaml").write_text(
        "bodies: {source: table, path: b.csv}\n"
        "spin: {n_i: 0.1, omega_xy0: 0.01}\nmodel: gh\n"
    )
    monkeypatch.chdir("/")
    assert len(rs.sweep(tmp_path / "c.yaml", output=tmp_path / "out").runs) == 2


STATE = f"{HEAD},omega_x,omega_y,omega_z,u_x,u_y,u_z"
BAD_TABLES = {
    "missing column": (
        "alpha,beta,gamma,theta,phi\n1,2,3,4,5\n",
        "the column xi is missing",
    ),
    "text cell": (
        f"{HEAD}\n{ROW}\n13,1.5,12,abc,0.1,-0.1\n",
        "row 2: theta is 'abc'; a finite",
    ),
    "empty cell": (
        f"{HEAD}\n{ROW}\n13,1.5,12,,0.1,-0.1\n",
        "row 2: theta is empty; a finite",
    ),
    "n_i alone": (
        f"{HEAD},n_i\n{ROW},0.1\n",
        "the column omega_xy0 is missing; a launch has n_i",
    ),
    "u too long": (
        f"{STATE}\n{ROW},0,0,1,0,0.5,-1\n",
        "row 1: u must be a vector of length 1",
    ),
    "at rest": (
        f"{STATE}\n{ROW},0,0,0,0,0,-1\n",
        "row 1: the body stands upright and at rest; give",
    ),
    "repeated": (
        f"{HEAD},theta\n{ROW},0.7\n",
        "the column theta is repeated; keep one",
    ),
    "a cell more in each row": (
        f"{HEAD}\n{ROW},\n{ROW},\n",
        "cannot be read as a table: its header has 6 columns and a row 7, ",
    ),
    "no rows": (f"{HEAD}\n", "the table has no rows; give at least one body"),
    "no height": (
        f"{HEAD},n_i_rpm\n{ROW},60\n",
        "the column height_m is missing; n_i_rpm needs ",
    ),
    "result": (
        f"{HEAD},type\n{ROW},granite\n",
        "the column type has the name of a result, which the runs will have; rename",
    ),
    "a reversal time": (
        f"{HEAD},t_r\n{ROW},7\n",
        "the column t_r has the name of a result, which the runs will have; rename",
    ),
    "an error": (
        f"{HEAD},t_r_error\n{ROW},7\n",
        "the column t_r_error has the name of a result",
    ),
    "two separators": (
        f"{HEAD};n_i\n{ROW};0.1\n",
        "its first line has semicolons and commas; separate the columns by one of",
    ),
    "blanks": (
        f"{HEAD}\n{ROW}\n".replace(",", " "),
        "the columns of its first line are separated by blanks; separate them by",
    ),
    "decimal commas between commas": (
        f"{HEAD}\n{ROW}\n".replace(".", ","),
        "its header has 6 columns and a row 12, separated by commas; if commas are",
    ),
    "decimal commas and points": (
        f"{HEAD}\n{ROW}\n{ROW.replace('.', ';')}\n".replace(",", "\t").replace(
            ";", ","
        ),
        "line 3 has a decimal comma and line 2 a decimal point; write all numbers in",
    ),
    "degrees": (
        f"{HEAD},n_i,omega_xy0,psi\n{ROW},1,0.1,30\n",
        "row 1: psi is 30; from -6.28319 to 6.28319 rad is allowed",
    ),
}


@pytest.mark.parametrize("name", BAD_TABLES)
def test_a_bad_table_is_told_by_its_row(name, tmp_path):
    text, sentence = BAD_TABLES[name]
    line = refusal(table(tmp_path, text))
    assert line.startswith("bodies.path: ")
    assert sentence in line


def test_a_file_that_is_no_table_is_refused_by_name(tmp_path):
    (tmp_path / "empty").mkdir()
    os.mkfifo(tmp_path / "pipe.csv")
    for name in ("b.parquet", "zero.csv", "notes.docx"):
        (tmp_path / name).write_bytes(b"PAR1\0\xe9" + bytes(range(256)))
    for path in tmp_path.iterdir():
        assert path.name in refusal({"source": "table", "path": str(path)})


def test_a_table_may_have_semicolons_or_tabs_and_decimal_commas(tmp_path):
    """They are what spreadsheets write in languages with decimal commas."""
    text = f"{HEAD},name\n{ROW},a\n9.3,2.1,9,0.81,0.07,-2e-2,b\n"
    expected = plan(table(tmp_path, text)).source.content_hash
    for separator in ("\t", ";"):
        dialect = text.replace(",", separator)
        assert plan(table(tmp_path, dialect)).source.content_hash == expected
        comma = dialect.replace(".", ",")
        assert plan(table(tmp_path, comma)).source.content_hash == expected
        marked = "\ufeff" + comma.replace("\n", "\r\n")
        assert plan(table(tmp_path, marked)).source.content_hash == expected


def test_results_are_taken_from_tables_of_runs_alone():
    body = {name: [getattr(rs.Rattleback.gh(), name)] for name in PARAMETERS}
    frame = pd.DataFrame({**body, "n_i": 0.1, "omega_xy0": 0.01})
    runs = rs.simulate(frame)
    assert rs.simulate(runs).t_r.equals(runs.t_r)
    for make in (rs.simulate, rs.sweep):
        with pytest.raises(
            ConfigError, match="the column t_r has the name of a result"
        ):
            make(frame.assign(t_r=7.0))


PAPERS = {
    "gamma": [10.0, 12.0],
    "f_sd": [0.1, 0.12],
    "theta": [0.8, 0.9],
    "phi": [0.05, 0.06],
}


def test_tables_in_memory_may_have_the_papers_own_parameters():
    """They give the same bodies as the function that takes these, for pandas, Polars
    and Arrow.
    """
    bodies = rs.Rattleback.shell_dumbbell(**PAPERS, xi=[-0.01, -0.02])
    launch = {"n_i": 0.3, "omega_xy0": 0.1}
    expected = rs.simulate(bodies, **launch)
    degrees = {"xi_deg": np.degrees([-0.01, -0.02])}
    turned = {"minus_xi_deg": np.degrees([0.01, 0.02])}
    for columns in (
        PAPERS | degrees,
        pd.DataFrame(PAPERS | degrees),
        pl.DataFrame(PAPERS | turned),
        pa.table(PAPERS | degrees),
    ):
        runs = rs.simulate(columns, **launch)
        assert runs.f_sd.tolist() == PAPERS["f_sd"]
        np.testing.assert_allclose(runs.t_r, expected.t_r, rtol=1e-9)
    with pytest.raises(
        ConfigError, match=r"row 2: f_sd is 0\.6; above 0 and below 0\.5 is needed"
    ):
        rs.simulate(PAPERS | degrees | {"f_sd": [0.1, 0.6]}, **launch)
    with pytest.raises(
        ConfigError, match="phi is missing; a body has gamma f_sd theta phi"
    ):
        rs.simulate({k: v for k, v in PAPERS.items() if k != "phi"} | degrees)


def test_a_frame_of_polars_is_swept(tmp_path):
    frame = pl.DataFrame(PAPERS | {"xi_deg": [-1.0, -2.0], "name": ["a", "b"]})
    keys = {"spin": {"n_i": 0.3, "omega_xy0": 0.1}, "model": "gh"}
    runs = rs.sweep(frame, output=tmp_path / "polars", **keys).runs
    again = rs.sweep(frame.to_pandas(), output=tmp_path / "pandas", **keys).runs
    assert runs.name.tolist() == ["a", "b"]
    pd.testing.assert_frame_equal(runs, again)


def test_a_table_is_identified_by_its_content(tmp_path):
    """The hash covers all columns of the runs, and not the bytes of the file."""
    text = f"{HEAD},n_i,omega_xy0,name\n{ROW},0.1,0.02,one\n{ROW},0.2,0.02,\n"
    csv = plan(table(tmp_path, text)).source
    pd.read_csv(tmp_path / "b.csv").to_parquet(tmp_path / "b.parquet")
    same = plan({"source": "table", "path": str(tmp_path / "b.parquet")}).source
    assert [*csv.carried] == [*same.carried] == ["name"]
    first = csv.content_hash
    assert first == same.content_hash == pickle.loads(pickle.dumps(csv)).content_hash
    for old, new in (
        ("0.1", "0.3"),
        ("one", "two"),
        ("omega_xy0,name", "omega_xy0,label"),
    ):
        changed = plan(table(tmp_path, text.replace(old, new))).source
        assert changed.content_hash != first


@pytest.mark.parametrize("psi", ["relevant", 30.0])
def test_an_output_table_is_a_valid_input_and_gives_the_same_results(psi, tmp_path):
    """Runs that reversed take the config's horizon; the others end when they ended
    before.
    """
    data = {
        "bodies": drawn(6, target={"K_r": [0.03, 0.1], "rel_tol": 0.05}),
        "spin": {"n_i": [-0.4, 0.1], "omega_xy0": 0.01, "psi": psi},
        "horizon": {"t_rgh": 3},
    }
    sweeping.sweep(tmp_path / "first", data)
    first = rows(tmp_path / "first")
    runs = tmp_path / "first" / "runs"
    had = first.t_r.notna().to_numpy()
    assert 0 < had.sum() < len(first) == 24
    assert (first.t_end[had] == first.t_r[had]).all()

    def again(name: str, horizon: dict[str, float]) -> pd.DataFrame:
        config = {"bodies": {"source": "table", "path": str(runs)}, "horizon": horizon}
        sweeping.sweep(tmp_path / name, config)
        return rows(tmp_path / name)

    same = [c for c in first.columns if c not in ("case", "sample")]
    repeated = again("again", {"t_rgh": 3})
    pd.testing.assert_frame_equal(first[same], repeated[same], check_exact=True)
    # With a shorter horizon in the config, only rows that have a t_r are cut.
    cut = again("short", {"t": 10})
    assert (cut.t_end[had] <= 10).all()
    assert np.array_equal(cut.t_end[~had], first.t_end[~had])


def test_a_folder_of_other_things_is_refused_before_it_is_searched(
    tmp_path, monkeypatch
):
    (tmp_path / "a").mkdir()
    (tmp_path / "a" / "notes.txt").write_text("no table")
    monkeypatch.setattr(tables.pq, "read_table", lambda *_, **__: pytest.fail("read"))
    with pytest.raises(ConfigError, match=r"notes\.txt, no Parquet file"):
        read_table(tmp_path, "bodies.path")
    (tmp_path / "a" / "notes.txt").unlink()
    monkeypatch.setattr(tables, "MOST_FILES", 3)
    for number in range(4):
        (tmp_path / "a" / f"{number}.parquet").write_bytes(b"PAR1")
    with pytest.raises(ConfigError, match="more than 3 files; put them into one"):
        read_table(tmp_path, "bodies.path")
