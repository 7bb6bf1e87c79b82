"""`verdict`: its table against the same launches one by one, its words, refusals."""

import json
import math
import re

import numpy as np
import pandas as pd
import pytest
from refusal import assert_refused
from sweeping import ROOT, invoke

import rattlesweep as rs
from rattlesweep.analysis.verdict import judged, sentence_of

STONE = {
    "shape": "half_ellipsoid",
    "length": "12 cm",
    "width": "3 cm",
    "height": "12 mm",
    "mass": "60 g",
    "skew": "3 deg",
}
BODY = rs.Rattleback.half_ellipsoid(**{k: v for k, v in STONE.items() if k != "shape"})
OPTIONS = ("--half-ellipsoid", "12cm,3cm,12mm", "--mass", "60g", "--skew", "3deg")
SENSES = {"counterclockwise": 1, "clockwise": -1}


PATCH = {"pivot": "54 um", "creep": 0.3}


@pytest.fixture(scope="module")
def found():
    return rs.verdict(BODY, **PATCH, progress=False)


def test_the_table_is_that_of_single_runs(found):
    """The first reversals, their number and the begin of rest, to the last bit."""
    table = found.table
    assert list(table["friction"].unique()) == ["none", "pivot 54 um, creep 0.3"]
    assert len(table) == 12
    for row in table[::3].to_dict("records"):
        losses = {} if row["friction"] == "none" else PATCH
        n_i = SENSES[row["direction"]] * row["spin_rpm"]
        run = rs.trajectory(
            BODY, n_i=f"{n_i} rpm", omega_xy0="6 rpm", t_end="20 s", points=2, **losses
        )
        unit = BODY.units.time
        assert row["reversals"] == len(run.reversals)
        if row["outcome"] == "turns back":
            assert row["t_s"] == pytest.approx(run.reversals[0] * unit, rel=1e-12)
            assert 0 < row["error_s"] < 1e-7 * row["t_s"]
        else:
            assert not len(run.reversals)
        assert row["sure"]
        once = rs.simulate(
            BODY, n_i=f"{n_i} rpm", omega_xy0="6 rpm", t_end="20 s", **losses
        )
        if row["outcome"] == "stops":
            assert once.t_r is None
            assert row["held_s"] == pytest.approx(once.t_held * unit, rel=1e-12)


def test_the_first_line(found):
    assert str(found).splitlines()[0] == found.sentence
    assert found.sentence == (
        "Turns back when spun counterclockwise at 30 to 120 rpm, after 1.1 to 1.3 s. "
        "Spun clockwise it turns back at 120 rpm, after 4.4 s, but hardly turns back "
        "at 60 rpm, after 5.4 s, and stops at 30 rpm."
    )
    mirrored = rs.verdict(BODY.mirrored(), spin="60 rpm", progress=False)
    assert mirrored.sentence.startswith("Turns back when spun clockwise at 60 rpm")
    times = found.table.query("friction == 'none' and spin_rpm == 60")["t_s"]
    assert list(mirrored.table["t_s"]) == pytest.approx(list(times), rel=1e-9)


def test_a_figure(found, tmp_path):
    figure = found.plot(tmp_path / "verdict.png")
    assert (tmp_path / "verdict.png").stat().st_size > 10_000
    assert [axes.get_title() for axes in figure.axes] == [""] * 6
    labels = [axes.get_title(loc="right") for axes in figure.axes]
    assert labels[3:] == [
        "stops after 4.3 s",
        "hardly turns back after 5.4 s",
        "turns back after 4.4 s",
    ]


@pytest.mark.slow
def test_stones_within_the_errors():
    stone = STONE | {"skew": "3 +- 0.2 deg", "height": "12 +- 0.1 mm"}
    found = rs.verdict(
        stone,
        spin=["60 rpm"],
        samples=32,
        pivot="54 +- 5 um",
        creep=0,
        progress=False,
    )
    rows = found.table.set_index(["direction", "friction"])
    assert (rows["samples"] == 32).all()
    sure = rows.loc["counterclockwise"]
    assert (sure["share"] == 1).all()
    assert (sure["low_s"] < sure["t_s"]).all()
    assert (sure["t_s"] < sure["high_s"]).all()
    unsure = rows.loc["clockwise", "pivot 54 +- 5 um"]
    assert 0 < unsure["share"] < 1
    assert not unsure["sure"]
    assert found.sentence.endswith("Not sure: 60 rpm clockwise.")
    # The ends of what was measured, one by one.
    for sign in (-2, 2):
        body = rs.Rattleback.half_ellipsoid(
            **{k: v for k, v in STONE.items() if k not in ("shape", "skew")},
            skew=f"{3 + sign * 0.2} deg",
        )
        run = rs.simulate(body, n_i="60 rpm", omega_xy0="6 rpm", t_end="20 s")
        low, high = sure.loc["none", ["low_s", "high_s"]]
        assert low * 0.9 < run.t_r_s < high * 1.1


def test_a_patch_that_pivots_also_creeps():
    """With `mu`, or else with 0.3."""
    launch = {"spin": "30 rpm", "t_end": "20 s", "progress": False}
    found = rs.verdict(BODY, pivot="60 um", **launch)
    assert list(found.table["friction"].unique()) == ["none", "pivot 60 um, creep 0.3"]
    assert "friction in the patch of contact is taken as 0.3" in found.remarks[0]
    given = rs.verdict(BODY, pivot="60 um", creep=0.3, **launch)
    assert given.remarks == ()
    pd.testing.assert_frame_equal(given.table, found.table)


def test_samples_that_are_no_stones():
    stone = STONE | {"height": "12 +- 8 mm"}
    found = rs.verdict(stone, spin="60 rpm", samples=16, t_end="2 s", progress=False)
    assert "of 16 samples are no stones, for example: height" in found.remarks[0]
    assert 0 < found.table["samples"].iloc[0] < 16


def test_a_stone_that_rolls_past_its_rim():
    found = rs.verdict(BODY, spin=["150 rpm", "250 rpm"], progress=False)
    row = found.table.iloc[1]
    assert (row["outcome"], row["status"]) == ("rolls past its rim", "rim")
    assert found.sentence.startswith(
        "Turns back when spun counterclockwise at 150 rpm, after 1.6 s, but rolls past "
        "its rim at 250 rpm."
    )


def turns_back(spin, **losses):
    """Whether a launch by itself passes a quarter of its spin on the other side."""
    run = rs.trajectory(
        BODY, n_i=f"{spin} rpm", omega_xy0="6 rpm", t_end="20 s", points=2000, **losses
    )
    other_side = -math.copysign(1, spin) * run.table["n_rpm"].to_numpy()
    return bool(other_side.max() > abs(spin) / 4), run.reversals


def test_what_would_change_it(found):
    """Each row turns back in a run of its own, and the launch before it does not."""
    advice = found.advice.set_index(["direction", "change"])
    assert found.advice["sure"].all()
    for direction, sign in SENSES.items():
        row = advice.loc[direction, "spin"]
        spin = sign * row["spin_rpm"]
        turns, reversals = turns_back(spin, **PATCH)
        assert turns
        assert row["t_s"] == pytest.approx(reversals[0] * BODY.units.time, rel=1e-6)
        assert not turns_back(0.97 * spin, **PATCH)[0]
    # All launches turn back in one direction; in the other, that at 60 rpm hardly does.
    assert list(advice.loc["counterclockwise"].index) == ["spin"]
    lever = advice.loc["clockwise", "lever"]
    assert (lever["spin_rpm"], lever["before"], lever["unit"]) == (60, 54, "um")
    assert 0 < lever["value"] < 54
    assert turns_back(-60, pivot=f"{lever['value']} um", creep=0.3)[0]
    assert not turns_back(-60, pivot=f"{1.1 * lever['value']} um", creep=0.3)[0]
    assert f"a lever of {lever['value']:g} um instead of 54 (" in lever["words"]
    text = str(found)
    for words in found.advice["words"]:
        assert words in text
    assert found.to_dict()["advice"] == found.advice.astype(object).where(
        found.advice.notna(), None
    ).to_dict("records")
    caption = found.plot()._supxlabel.get_text().replace("\n", " ")
    assert "Spun clockwise at 60 rpm, a lever of" in caption


def test_a_larger_skew_or_weights_that_would_do_it():
    little = STONE | {"skew": "0.9 deg"}
    found = rs.verdict(little, spin="60 rpm", t_end="8 s", progress=False)
    row = found.table.set_index("direction").loc["clockwise"]
    assert row["outcome"] != "turns back"
    advice = found.advice.set_index(["direction", "change"])
    skew = advice.loc["clockwise", "skew"]
    assert skew["before"] == pytest.approx(0.9)
    for factor, outcome in ((1.0, True), (0.95, False)):
        stone = STONE | {"skew": f"{factor * float(skew['value'])!r} deg"}
        again = rs.verdict(
            stone, spin="60 rpm", t_end="8 s", advice=False, progress=False
        )
        turned = again.table.set_index("direction").loc["clockwise", "outcome"]
        assert (turned == "turns back") == outcome
        assert again.advice is None
    weights = advice.loc["clockwise", "weights"]
    assert "two weights of 2 g at" in weights["words"]
    assert weights["sure"]


def rows_of(outcomes, direction="clockwise", times=(1.0, 2.0, 3.0)):
    return pd.DataFrame(
        {
            "direction": direction,
            "spin_rpm": [30.0, 60.0, 120.0],
            "outcome": outcomes,
            "t_s": times,
            "sure": True,
        }
    )


@pytest.mark.parametrize(
    ("outcomes", "others", "sentence"),
    [
        (
            ["turns back"] * 3,
            ["stops"] * 3,
            "Turns back when spun clockwise at 30 to 120 rpm, after 1.0 to 3.0 s. Spun "
            "counterclockwise it stops without turning back.",
        ),
        (
            ["stops", "spins on", "spins on"],
            ["stops", "turns back", "wobbles on"],
            "Turns back when spun counterclockwise at 60 rpm, after 2.0 s, but stops "
            "at 30 rpm and wobbles on at 120 rpm for 20 s. Spun clockwise it spins on "
            "at 60 and 120 rpm for 20 s and stops at 30 rpm without turning back.",
        ),
        (
            ["stops"] * 3,
            ["hardly turns back"] * 3,
            "Does not turn back. Spun clockwise it stops. Spun counterclockwise it "
            "hardly turns back, after 1.0 to 3.0 s.",
        ),
    ],
)
def test_words(outcomes, others, sentence):
    rows = pd.concat([rows_of(outcomes), rows_of(others, "counterclockwise")])
    assert sentence_of(rows, 20.0) == sentence


def test_what_is_not_sure():
    runs = rows_of(["turns back", "turns back", "stops"]).drop(columns="sure")
    tighter = rows_of(["turns back", "stops", "stops"], times=(1.01, np.nan, np.nan))
    assert list(judged(runs, tighter, 1e-9)["sure"]) == [False, False, True]
    runs.loc[2, "t_s"] = np.nan
    drawn = pd.concat([runs, runs, runs.assign(outcome="stops", t_s=np.nan)])
    table = judged(drawn, runs, 1e-9)
    assert list(table["share"]) == [0.5, 0.5, 0.0]
    assert list(table["sure"]) == [False, False, True]


def test_a_launch_that_fails_is_not_sure():
    fails = "fails (step_too_small)"
    never = (np.nan, np.nan, np.nan)
    runs = rows_of([fails, fails, "stops"], times=never).drop(columns="sure")
    tighter = rows_of([fails, "stops", fails], times=never)
    assert not judged(runs, tighter, 1e-9)["sure"].any()
    # What a stone can do is no mistake of the integration.
    real = rows_of(["rolls past its rim", "jams", "lifts off"], times=never)
    assert judged(real.drop(columns="sure"), real, 1e-9)["sure"].all()


def test_the_command(tmp_path):
    stone = ROOT / "configs" / "fit" / "stone.yaml"
    launch = ("--spin", "60rpm", "--t-end", "10s")
    text = invoke("verdict", stone, *launch).stdout
    other = invoke("verdict", *OPTIONS, *launch).stdout
    assert text == other
    assert text.startswith("Turns back when spun counterclockwise at 60 rpm, after 1.1")
    file = tmp_path / "stone.yaml"
    file.write_text(f"body: {json.dumps(STONE)}\ndissipation: {{pivot: 54 um}}\n")
    data = json.loads(invoke("verdict", file, "--json", *launch).stdout)
    frictions = {run["friction"] for run in data["runs"]}
    assert frictions == {"none", "pivot 54 um, creep 0.3"}
    assert data["runs"][0]["held_s"] is None
    assert invoke("verdict", *OPTIONS, "--spin", "250rpm").exit_code == 3
    sized = invoke("verdict", "--preset", "GH", "--length", "1cm", *launch).stdout
    assert sized.startswith("Turns back when spun counterclockwise at 60 rpm")


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--preset", "GH"), "--length: the body has no size"),
        ((*OPTIONS, "--length", "1cm"), "--length: the body has a size already"),
        ((*OPTIONS, "--spin", "60"), "--spin 60: has no unit; a spin is needed"),
        ((*OPTIONS, "--spin", "0rpm"), "--spin: a spin above zero is needed"),
        ((*OPTIONS, "--push", "6"), "--push 6: has no unit"),
        ((*OPTIONS, "--pivot", "0.002"), "--pivot: 0.002 has no unit"),
        (
            ("--preset", "GH", "--length", "1cm", "--sigma", "1e-7 N m s"),
            "--sigma: the body has no mass",
        ),
        (("STONE", "--mass", "60g"), "--mass: STONE has its own body"),
    ],
)
def test_refusals(options, words):
    stone = str(ROOT / "configs" / "fit" / "stone.yaml")
    options = [stone if each == "STONE" else each for each in options]
    assert_refused(invoke("verdict", *options), 2, words)


@pytest.mark.slow
def test_the_page(tmp_path):
    """What the page shows is what its command prints, but for digits of errors."""
    page = (ROOT / "docs" / "verdict.md").read_text()
    file = tmp_path / "mine.yaml"
    file.write_text(re.search(r"```yaml\n(.*?)```", page, re.DOTALL)[1])
    printed = invoke("verdict", file).stdout
    texts = re.findall(r"```text\n(.*?)```", page, re.DOTALL)
    shown = [text for text in texts if text.startswith(("Turns back", "what would"))]
    error = re.compile(r"\de-\d\d")
    assert error.sub("", "\n".join(shown)) == error.sub("", printed)
