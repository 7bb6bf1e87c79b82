"""Fits find what made the data, with intervals; what is wrong with data is one
sentence.
"""

from __future__ import annotations

import json
import math
import re
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from natural import natural
from refusal import assert_refused
from sweeping import ROOT, invoke

import rattlesweep as rs
from rattlesweep.analysis.fit import search, series, trials
from rattlesweep.analysis.fit.doubts import (
    doubts_of_data,
    doubts_of_exact_times,
    doubts_of_residuals,
)
from rattlesweep.analysis.fit.film import read_film, unwrapped
from rattlesweep.analysis.fit.scan import searches_of_times
from rattlesweep.analysis.fit.search import fit_run
from rattlesweep.analysis.fit.synthetic import synthetic_film
from rattlesweep.api.single import launch_of
from rattlesweep.design.launch import Launch
from rattlesweep.system import console

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


def test_progress_has_the_time_of_the_processor_and_that_in_all(monkeypatch, capsys):
    monkeypatch.setattr(console, "LINE_EVERY", 0.0)
    show = console.Bar(shown=False, lines=True).working("fit")
    show(159)
    assert capsys.readouterr().err == "fit, 159 runs, processor 0:00, 0:00 so far\n"


def test_exact_data_give_the_truth_back():
    table = rs.trajectory(
        BODY, **natural(**TRUTH, t_end=60), points=300, channels=["t", "n"]
    ).table
    table.loc[40:70, "n_rpm"] = np.nan
    spins = table[["t_s", "n_rpm"]]
    launch = natural(n_i=0.31, omega_xy0=0.03)
    fit = rs.fit(BODY, spins, free=["n_i", "sigma"], launch=launch)
    assert fit.rows == 300 - 31
    for name in ("n_i", "sigma"):
        assert fit.values[name] == pytest.approx(TRUTH[name], rel=1e-6)


def test_reversal_times_tell_the_friction():
    launch = natural(n_i=0.3, omega_xy0=0.03)
    run = rs.trajectory(BODY, **launch, **natural(sigma=4e-3), t_end="8 s", points=2)
    times = run.reversals * BODY.units.time
    assert len(times) >= 2
    fit = rs.fit(BODY, {"reversal_s": times}, free="sigma", launch=launch)
    assert fit.values["sigma"] == pytest.approx(4e-3, rel=1e-5)
    axes = fit.plot().axes[0]
    assert [line.get_linestyle() for line in axes.lines] == ["None", "None"]
    assert axes.get_xticks().tolist() == list(range(1, len(times) + 1))


@pytest.mark.slow
def test_exact_times_of_reversals_lead_to_the_truth():
    """The times jump with the friction by whole swings; one valley has no residuals."""
    launch = {"n_i": "60 rpm", "omega_xy0": "6 rpm"}
    run = rs.trajectory(BODY, **launch, sigma="1e-7 N m s", t_end="25 s", points=2)
    times = (run.reversals[:6] * BODY.units.time).round(5)
    fit = rs.fit(BODY, {"reversal_s": times}, free="sigma", launch=launch)
    value, low, high, _ = fit.in_si["sigma"]
    assert value == pytest.approx(1e-7, rel=1e-4)
    assert low < 1e-7 < high
    assert fit.noise < 1e-5
    assert fit.remarks == []


FAR = 20.0  # where the slopes promise residuals of many standard errors


@pytest.mark.slow
def test_a_valley_that_the_times_cannot_exclude_is_told_of(monkeypatch):
    def with_a_rival(*arguments):
        best = searches_of_times(*arguments)[0]
        return [best, replace(best, x=best.x + FAR)]

    monkeypatch.setattr(search, "searches_of_times", with_a_rival)
    launch = {"n_i": "60 rpm", "omega_xy0": "6 rpm"}
    times = {"reversal_s": [1.0942, 5.4864]}
    fit = rs.fit(BODY, times, free="sigma", launch=launch, error="0.01 s")
    (remark,) = [text for text in fit.remarks if "a worse valley" in text]
    scale = fit._estimate.problem.scales["sigma"] * fit.unit_of("sigma")[0]
    rival = fit.in_si["sigma"][0] + FAR * scale
    assert f"nearly as small at sigma {rival:.4g} N m s: this" in remark


def test_a_launch_far_from_the_film_is_replaced_by_what_the_film_shows():
    wrong = {"n_i": "88 rpm"}  # the film shows 104 rpm
    fit = rs.fit(BODY, film(), free=FREE, launch=wrong)
    for name, value in TRUTH.items():
        low, high = fit.intervals[name]
        assert low - (high - low) < value < high + (high - low)
    assert fit.noise == pytest.approx(0.51, rel=0.05)
    assert fit.remarks == []


def test_a_film_in_a_wrong_valley_is_told_of():
    measured = read_film(film(), BODY.units)
    waves = 0.1 * math.sqrt(2) * np.sin(measured.t)
    (remark,) = doubts_of_residuals(measured, waves, 0.1)
    assert remark.startswith(
        "the residuals are 5.73 deg, and the noise from row to row"
    )
    assert "a worse valley" in remark


def test_slow_waves_of_a_wrong_valley_are_told_of_although_neighbours_differ():
    measured = read_film(film(), BODY.units)
    generator = np.random.default_rng(3)
    noise = np.radians(0.5) * generator.standard_normal(len(measured.t))
    assert doubts_of_residuals(measured, noise, float(noise.std())) == []
    # A quarter of the power is a wave of nine rows, of which neighbours know little.
    wave = np.radians(0.41) * np.sin(math.tau / 9 * np.arange(len(noise)))
    residuals = noise + wave
    neighbours = np.corrcoef(residuals[1:], residuals[:-1])[0, 1]
    assert neighbours < 0.25
    (remark,) = doubts_of_residuals(measured, residuals, float(residuals.std()))
    assert "a worse valley" in remark


def test_exact_times_that_are_not_met_are_told_of():
    exact = read_film({"reversal_s": [1.09421, 5.48643, 9.1]}, BODY.units)
    second = 1 / BODY.units.time
    (remark,) = doubts_of_exact_times(exact, 0.043 * second)
    assert remark.startswith("the times are written to 1e-05 s and met within 0.043 s")
    assert "a worse valley" in remark
    assert doubts_of_exact_times(exact, 5e-5 * second) == []
    rough = read_film({"reversal_s": [1.09, 5.49, 9.1]}, BODY.units)
    assert doubts_of_exact_times(rough, 0.043 * second) == []
    known = read_film({"reversal_s": [1.09421, 5.48643]}, BODY.units, "0.02 s")
    assert doubts_of_exact_times(known, 0.043 * second) == []


@pytest.mark.slow
@pytest.mark.parametrize("n_i", [0.3, -0.3])
def test_a_free_shape_is_found_from_films_in_both_directions(n_i):
    truth = {"n_i": n_i, "omega_xy0": 0.03, "sigma": 4e-3}
    seconds = np.arange(0, 4, 1 / 120)
    times = seconds / BODY.units.time
    run = Launch(
        BODY,
        n_i=n_i,
        omega_xy0=0.03,
        losses={"sigma": 4e-3},
        t_end=float(times[-1]),
    )
    angles = np.degrees(trials.follow_quantity(run, "angle", times))
    angles += 0.5 * np.random.default_rng(12).standard_normal(len(times))
    data = {"t_s": seconds, "angle_deg": angles % 180}
    given = BODY.replace(xi=1.15 * BODY.xi, theta=0.98 * BODY.theta)
    fit = rs.fit(
        given, data, free=[*FREE, "skew", "theta"], launch=natural(n_i=1.1 * n_i)
    )
    truth |= {"skew": -BODY.xi, "theta": BODY.theta}
    for name, value in truth.items():
        low, high = fit.intervals[name]
        assert low - (high - low) < value < high + (high - low)
    assert fit.noise == pytest.approx(0.5, rel=0.1)
    assert fit.remarks == []


def test_a_tap_whose_spins_begin_with_zero_is_fitted():
    run = rs.trajectory(
        BODY, **natural(n_i=0, omega_xy0=0.1, t_end=40), points=60, channels=["t", "n"]
    )
    spins = run.table[["t", "n"]]
    assert spins.n[0] == 0
    fit = rs.fit(BODY, spins, free="omega_xy0", launch={"n_i": 0})
    assert fit.values["omega_xy0"] == pytest.approx(0.1, rel=1e-5)


@pytest.mark.parametrize("count", [2, 3, 4, 5, 6, 7])
def test_few_rows_of_spin_are_enough(count):
    rows = 5.0 * np.arange(count)
    launch = natural(n_i=0.3, omega_xy0=0.03)
    times = [f"{row!r} sqrt(a/g)" for row in rows.tolist()]
    run = rs.trajectory(BODY, **launch, t_end=times[-1], times=times, channels=["yaw"])
    spins = np.gradient(run.table["yaw"].to_numpy(), rows)
    data = {"t_s": rows * BODY.units.time, "spin_rad_s": spins / BODY.units.time}
    fit = rs.fit(BODY, data, free="n_i", launch={**launch, **natural(n_i=0.31)})
    assert fit.rows == count
    assert fit.values["n_i"] == pytest.approx(0.3, rel=0.02)


@pytest.mark.parametrize("rpm", [-600, -850])
def test_half_turns_between_frames_are_counted_by_the_spin_of_the_launch(rpm):
    t = np.arange(0, 1, 1 / 30)
    data = {"t_s": t, "angle_deg": (6 * rpm * t + 90) % 180 - 90}
    launch = {"n_i": f"{0.97 * rpm} rpm", "omega_xy0": "0.001 rpm"}
    fit = rs.fit(BODY, data, free="n_i", launch=launch)
    assert fit.in_si["n_i"][0] == pytest.approx(rpm, rel=1e-3)
    (remark,) = [text for text in fit.remarks if "from row to row, and spins" in text]
    assert f"turns by {abs(rpm) / 5:.3g} degrees" in remark
    assert "differ by 900 rpm look alike" in remark


UNPUSHED = natural(n_i=0.3, omega_xy0=1e-7)


def unpushed():
    """Return the spin of a stone without a push, with noise."""
    data = rs.trajectory(
        BODY, **UNPUSHED, **natural(sigma=4e-3, t_end=20), points=200
    ).table[["t", "n"]]
    data["n"] += 1e-3 * np.random.default_rng(1).standard_normal(200)
    return data


def test_parameters_that_only_their_ratio_is_told_of_are_both_named():
    fit = rs.fit(BODY, unpushed(), free=["sigma", "gamma"], launch=UNPUSHED)
    # One cause has one warning, which does not lead to a value without an error.
    (remark,) = fit.remarks
    assert remark.startswith("the data cannot tell sigma and gamma apart: measure")
    assert "give it with its error, as in 60 +- 1 g" in remark


def test_the_interval_of_a_push_that_is_hardly_told_is_that_of_its_profile():
    fit = rs.fit(
        BODY,
        unpushed(),
        free="omega_xy0",
        launch=UNPUSHED,
        **natural(sigma=4e-3),
    )
    (remark,) = fit.remarks
    assert remark.startswith(
        "the data hardly show an oscillation, and hardly tell omega_xy0: give the push"
    )
    low, high = fit.intervals["omega_xy0"]
    assert low < 1e-7 < high
    # A push of this size would be seen in the spin.
    assert high < 0.03
    interval = fit.profile("omega_xy0").attrs["interval"]
    assert fit.intervals["omega_xy0"] == pytest.approx(interval)
    # The fit with the push that is advised stands beside it, with its own interval.
    assert f"as in omega_xy0: {fit.push}, or film longer" in remark
    given = rs.fit(
        BODY,
        unpushed(),
        free="omega_xy0",
        launch={**UNPUSHED, "omega_xy0": fit.push},
        **natural(sigma=4e-3),
    )
    (found,) = fit.advised.intervals.values()
    assert found == pytest.approx(given.intervals["omega_xy0"], rel=1e-2)
    assert repr(fit).splitlines()[-1].startswith(f"with omega_xy0: {fit.push}, the")


def test_a_push_that_may_be_larger_than_the_spin_has_no_interval():
    data = unpushed()
    data = data[data.t < 0.01 * data.t.iloc[-1]]
    fit = rs.fit(BODY, data, free="omega_xy0", launch=UNPUSHED, **natural(sigma=4e-3))
    assert np.isnan(fit.intervals["omega_xy0"]).all()
    assert fit.table.loc["omega_xy0", ["low", "high"]].isna().all()
    assert " - " in repr(fit).splitlines()[1]
    low, high = fit.advised.intervals["omega_xy0"]
    assert 0 < low < high < 0.3


def test_a_film_of_radians_beyond_a_turn_is_told_of():
    t = np.linspace(0, 3, 300)
    slow = {"t_s": t, "angle_deg": 10 * t}
    (remark,) = doubts_of_data(read_film(slow, BODY.units), BODY.units)
    assert remark.startswith("the stone never turns faster than 1.67 rpm; if the")


def test_a_stone_file_and_a_config_are_told_apart(tmp_path):
    assert_refused(invoke("run", STONE), 2, "is a stone file, which fit, film,")
    config = tmp_path / "config.yaml"
    config.write_text("bodies: {source: preset, name: GH}\n")
    assert_refused(invoke("fit", config, DATA), 2, "is the config of a sweep, which")


def test_the_error_of_a_film_has_the_name_that_it_has_in_a_fit(tmp_path):
    stone = tmp_path / "stone.yaml"
    stone.write_text(STONE.read_text().replace("n_i:", "omega_xy0: 10 rpm, n_i:"))
    films = [
        invoke("film", stone, "--time", "0.1 s", name, "2 deg").stdout
        for name in ("--error", "--noise")
    ]
    assert films[0] == films[1] != invoke("film", stone, "--time", "0.1 s").stdout
    assert "--noise" not in invoke("film", "--help").stdout


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
            "body: {preset: KL}\nlaunch: {n_i: 9 rpm}\nfree: [sigma]",
            "t_s,n_rpm\n0,1\n1,2\n",
            "launch: omega_xy0 is missing; give its value, or list it under free",
        ),
        (
            "body: {preset: KL}\nfree: [n_i, n_i]",
            "t_s,n_rpm\n0,1\n1,2\n",
            "free: n_i is listed twice",
        ),
        (
            "body: {preset: KL}\nlaunch: {omega_xy0: 9 rpm}\nfree: [n_i]",
            "t_s,n_rpm\n0,1\n",
            "it has one row",
        ),
        (
            "body: {preset: KL}\nfree: [n_i, omega_xy0]",
            "mass A,,,\nt,x,y,angle\n0,1,1,2\n1,2,1,3\n",
            "reversal_s alone are needed, and the columns are t, x, y, angle",
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
    run = rs.trajectory(
        BODY, **natural(**TRUTH, t_end=30), points=100, channels=["t", "n"]
    )
    spins = run.table[["t_s", "n_rpm"]]
    spins["n_rpm"] *= factor
    launch = natural(n_i=0.31, omega_xy0=0.03)
    with pytest.raises(rs.ConfigError, match=sentence):
        rs.fit(BODY, spins, free="sigma", launch=launch)


def test_reversals_in_milliseconds_are_refused():
    launch = natural(n_i=0.3, omega_xy0=0.03)
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
    monkeypatch.setattr(series, "STARTS", 1)
    monkeypatch.setattr(series, "FILM_STEPS", 3)
    mirrored = BODY.replace(xi=-BODY.xi)
    launch = natural(n_i=0.3, omega_xy0=0.03)
    fit = rs.fit(mirrored, film()[:240], free="sigma", launch=launch)
    assert fit.noise > 20
    assert fit.remarks[0].startswith(
        f"the residuals are {fit.noise:.3g} deg: the model"
    )
    assert "try the other sign" in fit.remarks[0]


def test_a_trial_that_fails_is_a_bad_point_of_the_search(monkeypatch):
    run = rs.trajectory(
        BODY, **natural(**TRUTH, t_end=40), points=200, channels=["t", "n"]
    )
    follow = trials.Trials.follow
    failed = []

    def fragile(self, launches, kind, times):
        answers = follow(self, launches, kind, times)
        for place, launch in enumerate(launches):
            # The first start has an oscillation of 0.003.
            if launch.omega_xy0 < 0.02:
                failed.append(launch)
                answers[place] = rs.ConfigError(
                    "the run failed: the state became infinite"
                )
        return answers

    monkeypatch.setattr(trials.Trials, "follow", fragile)
    data = run.table[["t", "n"]]
    fit = rs.fit(BODY, data, free=["omega_xy0", "sigma"], launch=natural(n_i=0.3))
    assert failed
    assert fit.values["omega_xy0"] == pytest.approx(0.03, rel=1e-5)
    assert fit.values["sigma"] == pytest.approx(4e-3, rel=1e-5)
    # Where every trial fails, the reason is told.
    with pytest.raises(rs.ConfigError, match="the state became infinite"):
        rs.fit(BODY, data, free=["sigma"], launch=natural(n_i=0.3, omega_xy0=0.01))


def test_progress_counts_the_trials():
    counts = []
    measured = read_film(film(), BODY.units)
    launch = Launch(BODY, n_i=0.3, omega_xy0=0.03, losses={"sigma": 4e-3})
    fit_run(launch, measured, ["sigma"], counts.append)
    assert len(counts) > 20
    assert counts == list(range(1, len(counts) + 1))


@pytest.mark.parametrize(
    ("before", "header", "encoding"),
    [
        ("# filmed at 240 fps\n#\n", "t_s,angle_deg", "utf-8"),
        # As NumPy's savetxt writes it.
        ("# ", "t_s,angle_deg", "utf-8"),
        ("", "t_s;angle_deg", "utf-16"),
        ("# filmed in the hall\n", "t_s\tangle_deg", "utf-16"),
    ],
)
def test_tables_with_comments_or_in_utf_16_are_read(tmp_path, before, header, encoding):
    rows = ["0,10", "0.1,20", "0.2,30.5"]
    separator = header.strip("# ")[3]
    text = before + "\n".join([header, *(row.replace(",", separator) for row in rows)])
    path = tmp_path / "film.csv"
    path.write_text(text + "\n", encoding=encoding)
    found = read_film(path, BODY.units)
    assert np.degrees(found.value) == pytest.approx([10, 20, 30.5])
    assert found.t * BODY.units.time == pytest.approx([0, 0.1, 0.2])


def test_a_table_in_utf_16_without_its_mark_is_refused(tmp_path):
    path = tmp_path / "film.csv"
    path.write_text("t_s,angle_deg\n0,10\n", encoding="utf-16-le")
    with pytest.raises(rs.ConfigError, match="save it as UTF-8"):
        read_film(path, BODY.units)


@pytest.mark.slow
def test_a_row_that_is_far_off_is_named_and_can_be_left_out():
    first = film().iloc[:150]
    wrong = first.copy()
    wrong.loc[59, "angle_deg"] += 500
    plain = rs.fit(BODY, wrong, free=FREE, launch=LAUNCH)
    assert plain.noise > 3 * 0.51
    assert plain.remarks[0].startswith("row 60 is off by up to 4")
    assert "--robust" in plain.remarks[0]
    assert not any("worse valley" in remark for remark in plain.remarks)
    empty = first.copy()
    empty.loc[59, "angle_deg"] = np.nan
    expected = rs.fit(BODY, empty, free=FREE, launch=LAUNCH)
    robust = rs.fit(BODY, wrong, free=FREE, launch=LAUNCH, robust=True)
    assert robust.rows == expected.rows
    assert robust.remarks[0].endswith("and left out")
    for name in FREE:
        assert robust.values[name] == pytest.approx(expected.values[name], rel=1e-6)
        assert robust.intervals[name] == pytest.approx(
            expected.intervals[name], rel=1e-4
        )
    # Clean data are fitted as without it.
    clean = rs.fit(BODY, empty, free=FREE, launch=LAUNCH, robust=True)
    assert clean.remarks == expected.remarks


def test_a_fit_prints_its_table(tmp_path):
    few = film().iloc[:80]
    fit = rs.fit(BODY, few, free=FREE, launch=LAUNCH)
    few.to_csv(tmp_path / "few.csv", index=False)
    result = invoke("fit", STONE, tmp_path / "few.csv")
    printed = repr(fit)
    assert printed.startswith(result.stdout.rstrip())
    assert result.stderr.rstrip().endswith(printed.splitlines()[-1])
    assert fit.table.loc["n_i", "unit"] == "rpm"
    html = fit._repr_html_()
    assert html.startswith("<table")
    assert "torque -sigma omega" in html
    assert "noise" in html


def test_values_that_mean_nothing_exit_with_3(tmp_path):
    noise = np.random.default_rng(1).uniform(0, 180, 40)
    data = pd.DataFrame({"t_s": np.arange(40) / 60, "angle_deg": noise})
    data.to_csv(tmp_path / "noise.csv", index=False)
    stone = STONE.read_text().replace("n_i, omega_xy0, sigma]", "sigma]")
    stone = stone.replace("{n_i: 100 rpm,", "{n_i: 10 rpm, omega_xy0: 1 rpm,")
    (tmp_path / "stone.yaml").write_text(stone)
    result = invoke("fit", tmp_path / "stone.yaml", tmp_path / "noise.csv")
    assert "the values mean nothing" in result.stderr
    assert result.exit_code == 3


@pytest.mark.parametrize(
    ("loss", "truth", "push"),
    [
        pytest.param("pivot", "50 um", "1 rpm", marks=pytest.mark.slow),
        # The stone slides.
        pytest.param("mu", 0.05, "20 rpm", marks=pytest.mark.slow),
    ],
)
def test_a_film_tells_pivoting_and_sliding_friction(loss, truth, push):
    launch = {"n_i": "60 rpm", "omega_xy0": push}
    run = launch_of(BODY, **launch, **{loss: truth})
    film = synthetic_film(run, "2 s", 60)
    fit = rs.fit(BODY, film, free=["n_i", loss], launch={**launch, "n_i": "62 rpm"})
    assert fit.values["n_i"] == pytest.approx(run.n_i, rel=1e-5)
    assert fit.values[loss] == pytest.approx(run.losses[loss], rel=1e-5)


@pytest.mark.slow
def test_films_are_fitted_together_with_a_launch_each(tmp_path):
    stone = tmp_path / "stone.yaml"
    films = []
    for number, (n_i, push) in enumerate([("90 rpm", "9 rpm"), ("-70 rpm", "8 rpm")]):
        text = STONE.read_text().replace(
            "n_i: 100 rpm", f"n_i: {n_i}, omega_xy0: {push}"
        )
        stone.write_text(text.replace("{rolling: 0 um}", "{sigma: 5e-7 N m s}"))
        seed = ("--seed", number, "--time", "1.5 s")
        films.append(tmp_path / f"{number}.csv")
        result = invoke("film", stone, *seed)
        assert result.exit_code == 0, result.stderr
        films[-1].write_text(result.stdout)
    joint = rs.fit(BODY, films, free=FREE)
    names = ["n_i_1", "omega_xy0_1", "n_i_2", "omega_xy0_2", "sigma"]
    assert list(joint.values) == names == list(joint.table.index)
    truth = dict(zip(names, (90, 9, -70, 8, 5e-7), strict=True))
    for name, value in truth.items():
        row = joint.table.loc[name]
        width = row.high - row.low
        assert row.low - width < value < row.high + width
    # Two films tell the friction better than each alone, by the sum of their weights.
    weights = sum(1 / fit.covariance.loc["sigma", "sigma"] for fit in joint.alone)
    error = math.sqrt(joint.covariance.loc["sigma", "sigma"])
    assert error == pytest.approx(weights**-0.5, rel=0.1)
    plain = tmp_path / "plain.yaml"
    plain.write_text(STONE.read_text().replace("n_i: 100 rpm, ", ""))
    result = invoke("fit", plain, *films)
    assert result.exit_code == 0, result.stderr
    assert "n_i_2" in result.stdout
    assert "2 films, 360 rows" in result.stderr
    with pytest.raises(rs.ConfigError, match="several films share nothing"):
        rs.fit(BODY, films, free="n_i", launch={"omega_xy0": "9 rpm"})


@pytest.mark.parametrize("seed", [1, 3, 7])
def test_friction_is_not_surer_than_a_push_that_a_film_hardly_shows(seed):
    """The smaller the push, the larger the friction that fits a steady spin.

    A search from these films goes on to a push of zero, where friction seems sure.
    """
    run = launch_of(BODY, n_i="-70 rpm", omega_xy0="8 rpm", sigma="5e-7 N m s")
    film = synthetic_film(run, "1.5 s", 60, noise="0.5 deg", seed=seed)
    fit = rs.fit(BODY, film, free=FREE)
    low, high = fit.intervals["sigma"]
    assert low <= run.losses["sigma"] <= high
    assert low < 0.6 * high


@pytest.mark.slow
def test_an_interval_of_films_that_a_limit_cuts_off_ends_where_chi_squared_says():
    """Films without friction: the parabola would reach below zero.

    At a fixed friction each film can be fitted alone, and chi squared of all is a sum.
    """
    films = []
    for n_i, push in (("90 rpm", "9 rpm"), ("-70 rpm", "8 rpm")):
        run = launch_of(BODY, n_i=n_i, omega_xy0=push, sigma="0 N m s")
        films.append(synthetic_film(run, "1.5 s", 60, noise="0.5 deg", seed=4))
    joint = rs.fit(BODY, films, free=FREE, error="0.5 deg")
    low, high = joint.intervals["sigma"]
    assert low == 0

    def chi_squared(sigma):
        return sum(
            rs.fit(
                BODY,
                film,
                free=["n_i", "omega_xy0"],
                error="0.5 deg",
                sigma=f"{sigma!r} M a^2 sqrt(g/a)",
            ).chi_squared
            for film in films
        )

    rise = chi_squared(high) - chi_squared(joint.values["sigma"])
    assert rise == pytest.approx(1.96**2, rel=0.02)


def test_a_plan_tells_the_intervals_of_a_film(tmp_path):
    stone = tmp_path / "stone.yaml"
    text = STONE.read_text().replace("100 rpm", "98 rpm, omega_xy0: 10 rpm")
    stone.write_text(text.replace("rolling: 0 um", "sigma: 5e-7 N m s"))
    planned = invoke("fit", stone, "--plan", "2 s")
    assert planned.exit_code == 0, planned.stderr
    (tmp_path / "film.csv").write_text(invoke("film", stone, "--time", "2 s").stdout)
    fitted = invoke("fit", stone, tmp_path / "film.csv", "--error", "0.5 deg")
    for plan, fit in zip(
        planned.stdout.splitlines()[1:4], fitted.stdout.splitlines()[1:4], strict=True
    ):
        name, _, low, high = plan.split()[:4]
        assert fit.split()[0] == name
        _, fit_low, fit_high = map(float, fit.split()[1:4])
        assert float(high) - float(low) == pytest.approx(fit_high - fit_low, rel=0.1)
    assert_refused(invoke("fit", stone), 2, "DATA is missing")
    assert_refused(invoke("fit", STONE, "--plan", "2 s"), 2, "launch: omega_xy0")
    assert_refused(invoke("film", stone, "--time", "2 rpm"), 2, "time: '2 rpm'")
    assert_refused(invoke("film", stone, "--fps", 0), 2, "from 3 to 1,000,000")
