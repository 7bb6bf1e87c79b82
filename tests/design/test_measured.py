"""Tables in SI units, and columns of a table that are carried through to the runs."""

from __future__ import annotations

import math
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from sweeping import HEAD, ROW

import rattlesweep as rs
from rattlesweep.design.bodies import table
from rattlesweep.words.errors import ConfigWarning
from rattlesweep.words.units import quantity

STONES = pd.DataFrame(
    {
        "stone": ["grey", "red, long", "green"],
        "number": [7, 12, 3],
        "code": ["007", "012", "003"],
        "hardness": [5.5, 6.0, 6.25],
        "mass_kg": [1.0, 0.5, 0.25],
        "height_m": [0.01, 0.012, 0.02],
        "ixx_kg_m2": [2e-4, 1.2e-4, 1e-4],
        "iyy_kg_m2": [16e-4, 10e-4, 12e-4],
        "izz_kg_m2": [17e-4, 10.5e-4, 12.5e-4],
        "ixy_kg_m2": [-0.2e-4, -0.1e-4, -0.3e-4],
        "r1_m": [2.0, 1.0, 1.5],
        "r2_m": [0.045, 0.03, 0.05],
        "n_i_rpm": [60.0, -50.0, 30.0],
        "omega_xy0_rpm": [6.0, 20.0, 5.0],
        "t_end_s": [4.0, 6.0, 5.0],
    }
)


def sweep(path: Path, output: Path, **rest: Any) -> pd.DataFrame:
    config = {"bodies": {"source": "table", "path": str(path)}, **rest}
    return rs.sweep(config, output=output).runs


def test_bodies_and_launches_in_si_units(tmp_path):
    path = tmp_path / "stones.parquet"
    STONES.astype({"stone": "category"}).to_parquet(path)
    runs = sweep(path, tmp_path / "out")
    for run, given in zip(runs.itertuples(), STONES.itertuples(), strict=True):
        body = rs.Rattleback.from_si(
            mass=given.mass_kg,
            height=given.height_m,
            radii=(given.r1_m, given.r2_m),
            inertia=(
                given.ixx_kg_m2,
                given.iyy_kg_m2,
                given.izz_kg_m2,
                given.ixy_kg_m2,
            ),
        ).replace(units=None)
        second = math.sqrt(given.height_m / 9.81)
        rpm = math.pi / 30 * second
        assert [run.alpha, run.theta, run.xi, run.n_i, run.n_i_rpm] == pytest.approx(
            [body.alpha, body.theta, body.xi, given.n_i_rpm * rpm, given.n_i_rpm],
            rel=1e-12,
        )
        launch = {"n_i": run.n_i, "omega_xy0": given.omega_xy0_rpm * rpm}
        one = rs.simulate(body, **launch, t_end=given.t_end_s / second)
        assert (run.type, np.isnan(run.t_r)) == (one.type, one.t_r is None)
        if one.t_r is not None:
            assert run.t_r == pytest.approx(one.t_r, rel=1e-7)
            assert run.t_r_s == pytest.approx(run.t_r * second, rel=1e-14)
    assert runs.t_r_s.notna().any()
    kept = ["stone", "number", "hardness", "mass_kg", "height_m"]
    pd.testing.assert_frame_equal(runs[kept], STONES[kept], check_dtype=False)
    assert str(runs.number.dtype) == "int64"
    # The runs of a sweep are a table, whatever units it began with.
    again = sweep(
        tmp_path / "out" / "runs", tmp_path / "again", horizon={"t": "1e4 sqrt(a/g)"}
    )
    pd.testing.assert_frame_equal(again[kept], runs[kept])
    # The windows depend on the horizon.
    again, runs = (
        frame[runs.t_r.notna()].drop(columns="amp_growth") for frame in (again, runs)
    )
    pd.testing.assert_frame_equal(again, runs, check_exact=True)


@pytest.mark.slow
def test_shapes_of_different_sizes_are_launched_in_si_units(tmp_path):
    """Spins, losses and horizons of bodies that are drawn, one by one as in Python."""
    config = {
        "bodies": {
            "source": "shape",
            "length": ["11 cm", "13 cm"],
            "width": "34 mm",
            "height": "12 mm",
            "mass": "60 g",
            "weights": ["5 g", "9 g"],
            "at": ["45 mm", "-9 mm"],
            "wall": "3 mm",
            "samples": 3,
        },
        "spin": {"n_i": ["60 rpm", "-60 rpm"], "omega_xy0": "6 rpm"},
        "dissipation": {"rolling": ["0 um", "5 um"]},
        "horizon": {"t": "9 s"},
    }
    made = rs.sweep(config, output=tmp_path / "out")
    runs = made.runs
    summary = made.summary
    assert len(runs) == 12
    for run in runs.itertuples():
        stone = rs.Rattleback.half_ellipsoid(
            length=f"{run.shape_length_m!r} m",
            width="34 mm",
            height="12 mm",
            mass="60 g",
            wall="3 mm",
            weights=f"{run.shape_weights_kg!r} kg",
            at="45,-9 mm",
        )
        spin = f"{(60, -60)[run.case // 2]} rpm"
        rolling = f"{(0, 5)[run.case % 2]} um"
        one = rs.simulate(
            stone, n_i=spin, omega_xy0="6 rpm", t_end="9 s", rolling=rolling
        )
        assert (run.t_r, run.t_r_s, run.type) == (one.t_r, one.t_r_s, one.type)
    assert summary.n_i_rpm.tolist() == pytest.approx([60, 60, -60, -60], rel=1e-14)
    assert summary.rolling_m.tolist() == pytest.approx([0, 5e-6, 0, 5e-6], rel=1e-14)
    assert summary.n_i.isna().all()
    mean = runs.groupby("case").t_r_s.mean()
    assert summary.t_r_s_mean.tolist() == pytest.approx(mean.tolist(), rel=1e-13)
    assert b"(t = 9 s)" in made.report().content
    config["dissipation"]["rolling"].append("20 um")
    assert len(rs.sweep(config, output=tmp_path / "out").runs) == 18
    assert made.verify(recompute=3).problems == []
    path = made.replay(1, 2, t_end="9 s", points=2)
    assert path["t_s"].tolist() == pytest.approx([0, 9], rel=1e-14)
    config["spin"] = {"n_i": ["60 rpm", "0.1 sqrt(g/a)"], "omega_xy0": "6 rpm"}
    with pytest.raises(rs.ConfigError, match="give all of them in SI units, or none"):
        rs.sweep(config, output=tmp_path / "no")


def test_a_frame_is_swept_with_all_of_its_columns(tmp_path):
    """Surface, dissipation, units and own columns, as from a file; the table is kept
    whole.
    """
    frame = STONES.assign(
        c_m=[0.02, np.nan, 0.05], sigma=[0.0, 0.01, 0.02], rolling_m=[0.0, 1e-6, 0.0]
    )
    made = rs.sweep(frame, output=tmp_path / "out")
    runs = made.runs
    assert runs.c.tolist() == pytest.approx([2.0, np.nan, 2.5], nan_ok=True)
    assert runs.sigma.tolist() == [0.0, 0.01, 0.02]
    assert runs["rolling"].tolist() == pytest.approx([0, 1e-6 / 0.012, 0], rel=1e-14)
    (file,) = (tmp_path / "out").glob("bodies-*.parquet")
    source = table.frame_bodies(frame)
    again = table.read_bodies(str(file))
    assert again.content_hash == source.content_hash
    assert {*source.carried} == {
        "stone",
        "number",
        "code",
        "hardness",
        "mass_kg",
        "height_m",
    }
    assert rs.sweep(frame, output=tmp_path / "out").runs.equals(runs)
    # The same in memory.
    assert rs.simulate(runs).t_r.equals(runs.t_r)  # with the column c
    alone = rs.simulate(frame)
    assert alone.t_r.equals(runs.t_r)
    assert alone.sigma.equals(runs.sigma)


def test_columns_that_no_run_depends_on_are_named(tmp_path):
    """A misspelt column is seen; an empty direction is that of the config."""
    body = {name: getattr(rs.Rattleback.gh(), name) for name in table.PARAMETERS}
    launch = {"n_i": 0.1, "omega_xy0": 0.01, "t_end": 200.0}
    frame = pd.DataFrame(
        [{**body, **launch, "psi_deg": psi, "psy": 1} for psi in (30, None)]
    )
    with pytest.warns(ConfigWarning, match="columns carried along: psy$"):
        runs = rs.sweep(frame, output=tmp_path / "out").runs
    with pytest.warns(ConfigWarning, match="columns not used: psy$"):
        same = rs.simulate(frame)
    single = [rs.simulate("GH", **launch, psi=psi).t_r for psi in (30, None)]
    assert runs.t_r.tolist() == same.t_r.tolist() == single


def test_angles_in_degrees_and_the_unit_of_time_alone(tmp_path):
    path = tmp_path / "t.csv"
    body = ROW.replace("-0.03", "-1.72")
    head = HEAD.replace("xi", "xi_deg")
    path.write_text(f"{head},height_m,n_i,omega_xy0,psi_deg\n{body},0.02,0.3,0.1,30\n")
    runs = sweep(path, tmp_path / "out")
    second = math.sqrt(0.02 / 9.81)
    assert (runs.xi[0], runs.psi[0]) == (-math.radians(1.72), math.radians(30))
    assert runs.t_r_s[0] == pytest.approx(runs.t_r[0] * second, rel=1e-14)
    assert runs.n_i_rpm[0] == pytest.approx(0.3 / second * 30 / math.pi)


def test_columns_are_carried_as_what_they_hold(tmp_path):
    path = tmp_path / "t.csv"
    path.write_text(
        f"{HEAD},whole,gaps,real,words,height_m \n"
        f"{ROW},5,1,1.5,a b, +0.02 \n"
        f"{ROW},-7,,2,,0.02\n"
    )
    source = table.read_bodies(str(path))
    held = {
        k: ["nan" if x != x else x for x in v.tolist()]
        for k, v in source.carried.items()
    }
    assert held.pop("height_m") == [0.02, 0.02]
    assert held == {
        "whole": [5, -7],
        "gaps": [1.0, "nan"],
        "real": [1.5, 2.0],
        "words": ["a b", None],
    }


def test_an_inertia_per_mass_is_told_of():
    """A length squared that is called a moment of inertia makes a stone like foam."""
    sizes = {"mass": "60 g", "height": "7.5 mm", "radii": "30, 2 cm"}
    per_mass = np.array([0.5e-4, 7.5e-4, 7.7e-4, -0.05e-4])
    with pytest.warns(ConfigWarning, match="if the inertia is per mass, in m"):
        rs.Rattleback.from_si(**sizes, inertia=f"{str(per_mass.tolist())[1:-1]} kg m^2")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        inertia = f"{str((0.06 * per_mass).tolist())[1:-1]} kg m^2"
        rs.Rattleback.from_si(**sizes, inertia=inertia)


def test_a_unit_of_thousands_of_factors_is_refused_with_a_sentence():
    with pytest.raises(ValueError, match="has a unit of 15,003 characters"):
        quantity("1 " + 5000 * "kg*" + "m^2", "mass")
    # What is no product of units is found at once, however long its names are.
    with pytest.raises(ValueError, match="is not a product of units"):
        quantity("1 " + 60 * "m" + "!", "mass")
