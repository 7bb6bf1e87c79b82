"""The command `trajectory`: CSV, files, figures, and what it says of the run."""

import io
import json
from typing import Any

import matplotlib as mpl
import matplotlib.image
import numpy as np
import pandas as pd
import pyarrow.csv as pcsv
import pyarrow.parquet as pq
import pytest
from sweeping import invoke, plan_of, prepared

import rattlesweep as rs
from rattlesweep.analysis.onerun.course import Course, PreparedRun
from rattlesweep.analysis.room import misplaced_texts
from rattlesweep.design.launch import Launch
from rattlesweep.kernel.batch import integrate
from rattlesweep.kernel.method.tableau import METHODS
from rattlesweep.motion.model import FULL

GH = rs.Rattleback.gh()
CONTACT = ["t", "F_normal", "friction_ratio"]


def read_csv(text: str) -> pd.DataFrame:
    """Every digit of it."""
    table: pd.DataFrame = pcsv.read_csv(io.BytesIO(text.encode())).to_pandas()
    return table


def command(*args: Any) -> Any:
    return invoke("trajectory", "--preset", "GH", "--t-end", 130, *args)


def test_prints_csv_that_gives_the_same_numbers_back():
    channels = ["t", "n", "C_I", "u_x"]
    result = command("--points", 14, "--channels", ",".join(channels))
    run = rs.trajectory(
        GH, n_i=0.1, omega_xy0=0.01, t_end=130, points=14, channels=channels
    )
    assert np.array_equal(read_csv(result.stdout), run.table, equal_nan=True)
    assert "1 reversal at 112.09387" in result.stderr
    assert command("--points", 14, "-q").stderr == ""


@pytest.mark.parametrize(
    ("options", "wanted"),
    [
        (["--dt", 10], {"dt": 10.0}),
        (["--steps"], {"steps": True}),
        (["--psi", "30", "--points", 5], {"psi": 30.0, "points": 5}),
        (
            ["--omega", "0.02,0,-0.3"],
            {"omega": (0.02, 0, -0.3), "n_i": None, "omega_xy0": None},
        ),
    ],
    ids=str,
)
def test_options_mean_what_they_say(options, wanted):
    printed = read_csv(command(*options).stdout)
    run = rs.trajectory(GH, **({"n_i": 0.1, "omega_xy0": 0.01, "t_end": 130} | wanted))
    assert np.array_equal(printed.to_numpy(), run.table.to_numpy())


def test_files_hold_the_table_and_say_which_run_it_is(tmp_path):
    target = tmp_path / "run.parquet"
    names = "t,n,energy_drift,E_r,C_I"
    result = command("--output", target, "--channels", names)
    assert (result.exit_code, result.stdout) == (0, "")
    table = pq.read_table(target)
    run = rs.trajectory(
        GH, n_i=0.1, omega_xy0=0.01, t_end=130, channels=names.split(",")
    )
    assert np.array_equal(
        table.to_pandas().to_numpy(), run.table.to_numpy(), equal_nan=True
    )
    about = json.loads(table.schema.metadata[b"rattlesweep.run"])
    assert (about["theta"], about["t_end"], about["integrator"]["tol"]) == (
        0.6429,
        130.0,
        1e-9,
    )


def test_zeros_of_one_swing_are_one_reversal():
    """The spin crosses zero three times about 812 on its way from -0.1 to 0.1."""
    for t_end, turns, zeros in ((813, 0, 2), (1500, 1, 3)):
        path = rs.trajectory(GH, n_i=-0.1, omega_xy0=0.01, t_end=t_end)
        assert (len(path.reversals), len(path.zeros)) == (turns, zeros)


def test_contact_that_no_real_body_keeps_is_said():
    """Its time is within the step, as dense rows show."""
    lost = command("--n-i", 1, "--omega-xy0", 3, "--channels", "t,F_normal")
    path = rs.trajectory(GH, n_i=1, omega_xy0=3, t_end=1, dt=1e-4, channels=CONTACT)
    first = path.table["t"][np.argmax(path.table["F_normal"] < 0)]
    assert "warning: contact would be lost at t = " in lost.stderr
    said = float(lost.stderr.partition("lost at t = ")[2].partition(",")[0])
    assert said == pytest.approx(first, abs=2e-4)


@pytest.mark.parametrize(
    ("n_i", "t_end", "method"),
    [
        (0.4, 150, "dop853"),
        pytest.param(-0.3, 130, "verner98", marks=pytest.mark.slow),
    ],
)
def test_friction_between_steps_counts_for_the_warning(n_i, t_end, method):
    """As dense rows show, and as `record: [contact]` has it."""
    launch = {"n_i": n_i, "omega_xy0": 0.1}
    options = launch | {"t_end": t_end, "method": method, "channels": CONTACT}
    dense = rs.trajectory(GH, dt=1e-3, **options)
    ratio = dense.table["friction_ratio"].to_numpy()
    integrator = {"method": method}
    course = Course(PreparedRun.of(Launch(GH, n_i, 0.1, t_end, integrator=integrator)))
    course.columns()
    assert course.friction == pytest.approx(ratio.max(), rel=1e-4)
    first = dense.table["t"][np.argmax(ratio > 0.3)]
    said = float(course.warning.partition("from t = ")[2].partition(" on")[0])
    assert said == pytest.approx(first, rel=1e-3)
    config = {
        "bodies": {"source": "preset", "name": "GH"},
        "spin": launch,
        "horizon": {"t": t_end},
    }
    _, batch = prepared(plan_of(config))
    record = frozenset({"contact", "reversals"})
    stored = integrate(batch, METHODS[method], FULL, record=record).extreme(
        "contact_ratio_max"
    )[0]
    assert course.friction == pytest.approx(stored, rel=1e-4)


def test_a_figure_has_the_size_and_the_style_of_the_user(tmp_path):
    usual = tmp_path / "usual.png"
    own = tmp_path / "own.png"
    style = tmp_path / "grey.mplstyle"
    style.write_text("figure.facecolor: 808080\n")
    assert command("--figure", usual).exit_code == 0
    result = command("--figure", own, "--size", "3.35,2.5", "--style", style)
    assert result.exit_code == 0
    height, width, _ = matplotlib.image.imread(own).shape
    assert width / height == pytest.approx(3.35 / 2.5, rel=0.01)
    assert matplotlib.image.imread(usual).shape[1] / width == pytest.approx(
        7.2 / 3.35, rel=0.01
    )
    assert matplotlib.image.imread(own)[0, 0, :3] == pytest.approx(128 / 255, abs=0.01)


def test_a_narrow_figure_keeps_its_texts_apart():
    run = rs.trajectory(GH, n_i=0.1, omega_xy0=0.01, t_end=130.0, points=200)
    with mpl.rc_context({"figure.figsize": (3.35, 2.8)}):
        figure = run.plot()
    assert figure.get_size_inches() == pytest.approx([3.35, 2.8])
    assert misplaced_texts(figure) == []
    assert all(axes.get_ylabel() for axes in figure.axes)
    (legend,) = figure.legends
    assert legend.get_title().get_text().startswith("α 13.04")
    with (
        mpl.rc_context({"figure.figsize": (1.2, 2.8)}),
        pytest.raises(rs.ConfigError, match="give more"),
    ):
        run.plot()
