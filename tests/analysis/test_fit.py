"""Fits find what made the data, with intervals; what is wrong with data is one
sentence.
"""

from __future__ import annotations

import json
import math
import re

import numpy as np
import pandas as pd
import pytest
from refusal import assert_refused
from sweeping import ROOT, invoke

import rattlesweep as rs
from rattlesweep.analysis.fit import problem, search
from rattlesweep.analysis.fit.doubts import doubts_of_data
from rattlesweep.analysis.fit.film import read_film, unwrapped
from rattlesweep.analysis.fit.search import fit_run
from rattlesweep.sweeps.launches import Launch

STONE = ROOT / "configs/fit/stone.yaml"
DATA = ROOT / "configs/fit/data.csv"
BODY = rs.Rattleback.half_ellipsoid(
    length="12 cm", width="3 cm", height="12 mm", mass="60 g", skew="3 deg"
)
TRUTH = {"n_i": 0.3, "omega_xy0": 0.03, "sigma": 4e-3}


def test_the_command_prints_what_the_page_shows(tmp_path):
    picture = tmp_path / "fit.png"
    result = invoke("fit", STONE, DATA, "--figure", picture)
    assert result.exit_code == 0, result.stderr
    # Lines of progress come before.
    summary = result.stderr.splitlines()[-1]
    assert result.stdout + summary in (ROOT / "docs/fit.md").read_text()
    assert picture.stat().st_size > 10_000
    for line in result.stdout.splitlines()[1:4]:
        name, *numbers = line.split()[:4]
        value, low, high = map(float, numbers)
        assert low < value < high
        assert low - (high - low) < TRUTH[name] < high + (high - low)
    (tmp_path / "few.csv").write_text(
        "".join(DATA.read_text().splitlines(keepends=True)[:80])
    )
    printed = json.loads(
        invoke("fit", STONE, tmp_path / "few.csv", "--json", "-q").stdout
    )
    assert printed["values"].keys() == printed["intervals"].keys() == TRUTH.keys()
    rpm = 30 / math.pi / BODY.units.time
    assert printed["in_si"]["n_i"] == pytest.approx(
        [rpm * x for x in (printed["values"]["n_i"], *printed["intervals"]["n_i"])]
        + ["rpm"]
    )


def test_exact_data_give_the_truth_back():
    table = rs.trajectory(
        BODY, **TRUTH, t_end=60, points=300, channels=["t", "n"]
    ).table
    table.loc[40:70, "n_rpm"] = np.nan
    spins = table[["t_s", "n_rpm"]]
    launch = {"n_i": 0.31, "omega_xy0": 0.03}
    fit = rs.fit(BODY, spins, free=["n_i", "sigma"], launch=launch)
    assert fit.rows == 300 - 31
    for name in ("n_i", "sigma"):
        assert fit.values[name] == pytest.approx(TRUTH[name], rel=1e-6)


def test_reversal_times_tell_the_friction():
    launch = {"n_i": 0.3, "omega_xy0": 0.03}
    run = rs.trajectory(BODY, **launch, sigma=4e-3, t_end="8 s", points=2)
    times = run.reversals * BODY.units.time
    assert len(times) >= 2
    fit = rs.fit(BODY, {"reversal_s": times}, free="sigma", launch=launch)
    assert fit.values["sigma"] == pytest.approx(4e-3, rel=1e-5)
    axes = fit.plot().axes[0]
    assert [line.get_linestyle() for line in axes.lines] == ["None", "None"]
    assert axes.get_xticks().tolist() == list(range(1, len(times) + 1))


def test_parameters_that_only_their_ratio_is_told_of_are_both_named():
    launch = {"n_i": 0.3, "omega_xy0": 1e-7}
    data = rs.trajectory(BODY, **launch, sigma=4e-3, t_end=20, points=200).table[
        ["t", "n"]
    ]
    data["n"] += 1e-3 * np.random.default_rng(1).standard_normal(200)
    fit = rs.fit(BODY, data, free=["sigma", "gamma"], launch=launch)
    assert "the data cannot tell sigma and gamma apart" in fit.remarks[0]


def test_an_axis_is_followed_through_half_turns_and_gaps():
    t = np.linspace(0, 10, 400)
    angle = 9 * t - 0.9 * t**2
    seen = np.remainder(angle, math.pi)
    seen[100:130] = np.nan
    continuous = unwrapped(t, seen)
    known = np.isfinite(seen)
    assert np.ptp((continuous - angle)[known]) < 1e-9


@pytest.mark.parametrize(
    ("stone", "data", "words"),
    [
        ("body: {preset: GH", "", "stone.yaml:"),
        (
            "body: {preset: XY}\nfree: [sigma]",
            "",
            'body: preset: "XY" is not one of GH, KL',
        ),
        (
            "body: {preset: GH}\nfree: [signa]",
            "t,n\n0,1\n1,1\n",
            'did you mean "sigma"?',
        ),
        (
            "body: {preset: GH}\nfree: [sigma]",
            "t_s,n_rpm\n0,1\n",
            "the body has no size",
        ),
        ("body: {preset: KL}\nfree: [sigma]", "t_s,n_rpm\n0,1\n0,2\n", "row 2"),
        (
            "body: {preset: KL}\nfree: [sigma]",
            "t_s,n_rpm\n0,a\n",
            "row 1: n_rpm is a, not",
        ),
        (
            "body: {preset: KL}\nfree: [sigma]",
            "t_s,n_rpm\n",
            "no row has a value of n_rpm",
        ),
        (
            "body: {preset: KL}\nfree: [sigma]",
            "t_s,n_rpm\n0,1\n,2\n",
            "t_s has no finite",
        ),
        (
            "body: {preset: KL}\nfree: [sigma]",
            "t_s,angle_deg\n0,1\n1,\n",
            "1 value cannot",
        ),
        (
            "body: {preset: KL}\nfree: [sigma]",
            "reversal_s\n-1\n",
            "reversal_s is -1; the",
        ),
        (
            "body: {preset: KL}\nfree: [c]\nlanch: 1",
            "",
            'stone.yaml:3: lanch: unknown key "lanch"',
        ),
        (
            "body: {shape: half_ellipsoid, lenght: 1 cm}\nfree: [c]",
            "",
            'did you mean "length"?',
        ),
        (
            "body: {shape: half_ellipsoid, length: 1 cm}\nfree: [c]",
            "",
            "width is missing",
        ),
        (
            "body: {preset: KL}\nfree: [c]",
            "t_s,angle_deg\n0,inf\n1,\n",
            "no row has a value",
        ),
        (
            "body: {preset: KL, xi_deg: a}\nfree: [c]",
            "",
            "xi_deg: 'a' is not a number",
        ),
        (
            "body: {preset: KL}\nfree: []",
            "t_s,n_rpm\n0,1\n1,2\n",
            "no parameter is given",
        ),
    ],
)
def test_bad_input_is_one_sentence(tmp_path, stone, data, words):
    (tmp_path / "stone.yaml").write_text(stone + "\n")
    (tmp_path / "data.csv").write_text(data)
    result = invoke("fit", tmp_path / "stone.yaml", tmp_path / "data.csv")
    assert_refused(result, 2, words)
    assert_refused(invoke("fit", STONE, tmp_path / "none.csv"), 2, "no such file")


def film() -> pd.DataFrame:
    """The film of the page, whose launch is 98 rpm."""
    return pd.read_csv(DATA)


FREE = ["n_i", "omega_xy0", "sigma"]
LAUNCH = {"n_i": "100 rpm"}
MIRRORED = {"angle_deg": lambda film: 180 - film.angle_deg}
RADIANS = {"angle_deg": lambda film: np.radians(film.angle_deg)}
MILLISECONDS = {"t_s": lambda film: 1000 * film.t_s}


@pytest.mark.parametrize(
    ("change", "launch", "sentence"),
    [
        (MIRRORED, LAUNCH, "the other way; angles are counterclockwise"),
        (RADIANS, LAUNCH, "jumps by 3.11, as angles in radians do"),
        (RADIANS, {}, "name the column angle_rad"),
        (MILLISECONDS, LAUNCH, "if the times are in ms, name the column t_ms"),
        (MILLISECONDS, {}, "if the times are in ms, name the column t_ms"),
        (
            {"angle_deg": lambda film: film.angle_deg.where(film.t_s < 0.15) / 57.3},
            LAUNCH,
            "if angle_deg is in rad, name it angle_rad",
        ),
    ],
    ids=["mirrored", "radians", "radians-alone", "ms", "ms-alone", "unfolded-radians"],
)
def test_a_film_in_other_units_or_mirrored_is_refused(change, launch, sentence):
    wrong = film().assign(**change)
    with pytest.raises(rs.ConfigError, match=re.escape(sentence)):
        rs.fit(BODY, wrong, free=FREE, launch=launch)


@pytest.mark.parametrize(
    ("factor", "sentence"),
    [
        (math.pi / 30, "if n_rpm is in rad_s, name it n_rad_s"),
        (-1.0, "the other way"),
    ],
)
def test_a_spin_in_other_units_or_mirrored_is_refused(factor, sentence):
    run = rs.trajectory(BODY, **TRUTH, t_end=30, points=100, channels=["t", "n"])
    spins = run.table[["t_s", "n_rpm"]]
    spins["n_rpm"] *= factor
    launch = {"n_i": 0.31, "omega_xy0": 0.03}
    with pytest.raises(rs.ConfigError, match=sentence):
        rs.fit(BODY, spins, free="sigma", launch=launch)


def test_reversals_in_milliseconds_are_refused():
    launch = {"n_i": 0.3, "omega_xy0": 0.03}
    times = {"reversal_s": [2139.0, 5000.0]}
    with pytest.raises(rs.ConfigError, match="name the column reversal_ms"):
        rs.fit(BODY, times, free="sigma", launch=launch)


def test_a_gap_is_told():
    gap = film()
    gap.loc[gap.t_s.between(0.6, 1.2), "angle_deg"] = np.nan
    (remark,) = doubts_of_data(read_film(gap, BODY.units), BODY.units)
    assert re.search(r"no angle between 0.59\d+ and 1.2\d* s, and half a turn", remark)
    assert doubts_of_data(read_film(film(), BODY.units), BODY.units) == []


def test_large_residuals_are_told(monkeypatch):
    # The search cannot succeed: a body of the other skew does not turn like this one.
    monkeypatch.setattr(search, "FINE", ())
    monkeypatch.setattr(search, "MOST_STEPS", 3)
    mirrored = BODY.replace(xi=-BODY.xi)
    launch = {"n_i": 0.3, "omega_xy0": 0.03}
    fit = rs.fit(mirrored, film()[:240], free="sigma", launch=launch)
    assert fit.noise > 20
    assert fit.remarks[0].startswith(
        f"the residuals are {fit.noise:.3g} deg: the model"
    )
    assert "try the other sign" in fit.remarks[0]


def test_a_trial_that_fails_is_a_bad_point_of_the_search(monkeypatch):
    run = rs.trajectory(BODY, **TRUTH, t_end=40, points=200, channels=["t", "n"])
    follow = problem.follow
    failed = []

    def fragile(launch, kind, times):
        # The first start has an oscillation of 0.003.
        if launch.omega_xy0 < 0.02:
            failed.append(launch)
            raise rs.ConfigError("the run failed: the state became infinite")
        return follow(launch, kind, times)

    monkeypatch.setattr(problem, "follow", fragile)
    data = run.table[["t", "n"]]
    fit = rs.fit(BODY, data, free=["omega_xy0", "sigma"], launch={"n_i": 0.3})
    assert failed
    assert fit.values["omega_xy0"] == pytest.approx(0.03, rel=1e-5)
    assert fit.values["sigma"] == pytest.approx(4e-3, rel=1e-5)
    # Where every trial fails, the reason is told.
    with pytest.raises(rs.ConfigError, match="the state became infinite"):
        rs.fit(BODY, data, free=["sigma"], launch={"n_i": 0.3, "omega_xy0": 0.01})


def test_progress_grows_to_the_end():
    shares = []
    measured = read_film(film(), BODY.units)
    launch = Launch(BODY, n_i=0.3, omega_xy0=0.03, losses={"sigma": 4e-3})
    fit_run(launch, measured, ["sigma"], shares.append)
    assert len(shares) > 20
    assert 0 <= shares[0] <= shares[-1] <= 1
    assert shares == sorted(shares)
