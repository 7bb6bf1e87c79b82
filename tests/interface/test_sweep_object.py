"""A sweep as Python has it: tables, xarray, pictures and pages of one directory."""

import numpy as np
import pandas as pd
import pytest

import rattlesweep as rs
from rattlesweep.words.errors import ConfigWarning
from rattlesweep.work.verify import verify

GH = rs.Rattleback.gh()
PARAMETERS = ["alpha", "beta", "gamma", "theta", "phi", "xi"]


@pytest.fixture(scope="module")
def sd(tmp_path_factory):
    """Two targets, two spins in descending order, five bodies each."""
    config = {
        "bodies": {
            "source": "sd",
            "samples": 5,
            "target": {"K_r": [0.1, 0.03], "rel_tol": 0.1},
        },
        "spin": {"n_i": [0.3, -0.3], "omega_xy0": 0.1},
        "horizon": {"t": 50},
        "record": ["energy", "windows"],
    }
    return rs.sweep(config, output=tmp_path_factory.mktemp("sd") / "out", threads=1)


@pytest.fixture(scope="module")
def grid(tmp_path_factory):
    """A map of GH's body by two parameters and the spin."""
    config = {
        "bodies": {
            "source": "grid",
            "base": {"preset": "GH"},
            "axes": {"theta": [0.8, 0.6, 0.7], "minus_xi_deg": [1, 2]},
        },
        "spin": {"n_i": [0.2, 0.4], "omega_xy0": 0.1},
        "horizon": {"t": 40},
    }
    return rs.sweep(config, output=tmp_path_factory.mktemp("grid") / "out", threads=1)


def test_read_chooses_columns_and_runs(sd):
    everything = sd.read()
    pd.testing.assert_frame_equal(everything, sd.runs)
    assert len(everything) == 20
    some = sd.read(["t_r", "case"], where='n_i > 0 and type == "R"')
    chosen = everything[(everything.n_i > 0) & (everything.type == "R")]
    assert 0 < len(some) < 20
    pd.testing.assert_frame_equal(some, chosen[["t_r", "case"]].reset_index(drop=True))
    assert list(sd.read("theta")) == ["theta"]
    assert some.attrs["units"] == {"t_r": "sqrt(a/g)", "case": "1"}
    assert "first zero of the spin" in some.attrs["descriptions"]["t_r"]
    assert sd.summary.attrs["units"]["t_r_mean"] == "sqrt(a/g)"


def test_what_a_notebook_user_expects(sd):
    assert sd["t_r"].equals(sd.runs.t_r)
    assert list(sd[["n_i", "t_r"]]) == ["n_i", "t_r"]
    assert sd.config["horizon"] == {"t": 50}
    assert repr(sd) == f"<Sweep {sd.directory}: 20 runs>"
    assert "fraction_SS" in sd._repr_html_()
    same = sd.compare(sd)
    assert "all 20 runs" in repr(same)
    assert not same.disagree(0.0)


def test_other_thresholds_and_back(sd):
    before = sd["type"].tolist()
    changed = sd.classify(sw_departure=1e-6, ss_growth=1e-9)
    assert changed.attrs["units"]["t_r_mean"] == "sqrt(a/g)"
    assert sd["type"].tolist() != before
    with pytest.raises(rs.ConfigError, match="sw_departed"):
        sd.classify(sw_departed=1)
    sd.classify()
    assert sd["type"].tolist() == before


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (
            lambda s: s.read("t_R"),
            r'columns: "t_R" is not one of .*did you mean "t_r"\?',
        ),
        (
            lambda s: s.read(where="tpye == 'R'"),
            "where tpye == 'R': .tpye. is not one of",
        ),
        (
            lambda s: s.plot(path="a.gif"),
            "path a.gif: the name must end in .svg, .png, .pdf",
        ),
        (
            lambda s: s.plot(select={"n_i": 0.7}),
            "^select n_i=0.7: n_i has no value 0.7",
        ),
        (lambda s: s.show(), "which run. give case and sample, or where"),
        (lambda s: s.plot(size=3), r"size: 3 \(int\) is not a pair of numbers"),
        (lambda s: s.plot(xlim="x"), r"xlim: 'x' \(str\) is not a number"),
        (lambda s: s.to_xarray(where=3), "^where 3: it is no condition"),
        (
            lambda s: s.verify(recompute=-1),
            "recompute: -1 is given; a whole number of at least 0 is needed",
        ),
        (
            lambda s: s.report("report.pdf"),
            "path report.pdf: the name must end in .html",
        ),
        (
            lambda s: s.verify(recompute=2.5),
            r"recompute: 2.5 \(float\) is given; a whole number of at least 0",
        ),
        (lambda s: rs.sweep("c.yaml", seed=1), "seed: keys go with a DataFrame only"),
        (
            lambda s: rs.sweep("c.yaml", executor="dask"),
            "^executor: rs.sweep has no such argument; executors are chosen by `rattl",
        ),
        (
            lambda s: rs.sweep("c.yaml", thread=1),
            '^thread: rs.sweep has no such argument; did you mean "threads"',
        ),
    ],
)
def test_bad_arguments_get_a_sentence_and_nothing_is_written(sd, call, words):
    before = sorted(sd.directory.rglob("*"))
    with pytest.raises(rs.ConfigError, match=words):
        call(sd)
    assert sorted(sd.directory.rglob("*")) == before


def test_a_map_is_a_dataset_of_its_axes(grid):
    data = grid.to_xarray()
    assert dict(data.sizes) == {"n_i": 2, "omega_xy0": 1, "theta": 3, "minus_xi_deg": 2}
    assert data.theta.values.tolist() == [0.6, 0.7, 0.8]
    assert (data.n_i.attrs["units"], data.minus_xi_deg.attrs["units"]) == (
        "sqrt(g/a)",
        "degree",
    )
    assert data.t_r.attrs["units"] == "sqrt(a/g)"
    assert data.t_r.attrs["long_name"].startswith("first zero")
    assert {"theta", "n_i", "case", "sample"} & set(data.data_vars) == set()
    rows = grid.read()
    assert data.t_r.notnull().sum() == rows.t_r.notna().sum() > 0
    for _, row in rows.iterrows():
        here = data.sel(n_i=row.n_i, omega_xy0=0.1, theta=row.theta).sel(
            minus_xi_deg=-np.degrees(row.xi), method="nearest"
        )
        for name in ("n_steps", "type", "xi"):
            assert here[name].item() == row[name]
    assert data.n_steps.dtype == np.int64
    # What is not chosen is missing.
    part = grid.to_xarray(["t_r", "type"], where="type == 'R'")
    assert (part.type.values == "").sum() == (rows.type != "R").sum() > 0


def test_columns_of_lists_are_named_where_a_dataset_leaves_them_out(tmp_path):
    config = {"bodies": {"source": "preset", "name": "GH"}, "record": ["reversals"]}
    config |= {"spin": {"n_i": 0.1, "omega_xy0": 0.01}, "horizon": {"t": 120}}
    sweep = rs.sweep(config, output=tmp_path / "o", threads=1)
    with pytest.warns(ConfigWarning, match="columns of lists are left out: turn_times"):
        data = sweep.to_xarray()
    assert "t_r" in data
    assert "turn_times" not in data
    assert list(sweep.to_xarray(["t_r"])) == ["t_r"]
    with pytest.raises(
        rs.ConfigError, match="turn_times has a list for each run; see read"
    ):
        sweep.to_xarray(["turn_times"])


def test_random_bodies_are_a_dataset_of_samples(sd):
    assert list(sd.to_xarray("t_r").data_vars) == ["t_r"]
    data = sd.to_xarray(["t_r", "K_r", "theta"])
    assert dict(data.sizes) == {"K_r": 2, "n_i": 2, "omega_xy0": 1, "sample": 5}
    at = data.sel(K_r=0.1, n_i=-0.3, omega_xy0=0.1)
    assert at.theta.values.tolist() == sd.read(where="case == 1").theta.tolist()


def test_pictures_and_pages(sd, tmp_path):
    figure = sd.plot("times", select={"K_r": [0.03, 0.1]}, path=tmp_path / "times.svg")
    assert (tmp_path / "times.svg").read_text().startswith("<?xml")
    assert figure._repr_png_()[:4] == b"\x89PNG"
    page = sd.report(tmp_path / "report.html", title="Mine & yours")
    assert page.path.read_bytes() == page.content
    rolling = sd.show(0, 1, t_end=10, from_time=4, path=tmp_path / "roll.html")
    assert '"start": 4.0' in rolling.path.read_text()


BODIES = pd.DataFrame([vars(GH)] * 3)[PARAMETERS].assign(theta=[0.6, 0.7, 0.8])
KEYS = {"spin": {"n_i": [0.2], "omega_xy0": 0.1}, "horizon": {"t": 30}}


def test_a_sweep_of_a_table_in_memory(tmp_path, monkeypatch):
    output = tmp_path / "out"
    done = rs.sweep(BODIES, output=output, threads=1, **KEYS)
    pd.testing.assert_frame_equal(done.read(PARAMETERS), BODIES)
    alone = rs.simulate(BODIES, n_i=0.2, omega_xy0=0.1, t_end=30)
    pd.testing.assert_frame_equal(done.read(list(alone)), alone)
    # The same bodies go on, other ones do not.
    (path,) = (output / "runs").iterdir()
    before = path.stat()
    again = rs.sweep(BODIES, output=output, threads=1, **KEYS)
    assert path.stat().st_ino == before.st_ino
    pd.testing.assert_frame_equal(again.runs, done.runs)
    with pytest.raises(rs.ConfigError, match="holds another sweep"):
        rs.sweep(BODIES.assign(phi=0.04), output=output, **KEYS)
    assert len(list(output.glob("bodies-*.parquet"))) == 1
    # The directory has all it needs, wherever it is.
    moved = output.rename(tmp_path / "moved")
    monkeypatch.chdir(tmp_path)
    assert verify(moved, recompute=3).problems == []
    assert rs.load("moved").replay(0, 1, points=2).t_end == 30
