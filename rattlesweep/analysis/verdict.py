"""Whether a stone turns back: outcomes of its runs, a verdict in words, a figure."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from rattlesweep.analysis import room, style
from rattlesweep.analysis.onerun.figure import shown
from rattlesweep.analysis.style import BLUE, INK, SILVER
from rattlesweep.arrays import Floats
from rattlesweep.system.console import align, joined

NO_FRICTION = "none"
COUNTERCLOCKWISE = "counterclockwise"
CLOCKWISE = "clockwise"
SIGN_OF_DIRECTION = {COUNTERCLOCKWISE: 1, CLOCKWISE: -1}
TURNS = "turns back"
HARDLY = "hardly turns back"
STOPS = "stops"
FAILS = "fails"
OF_STATUS = {
    "lifts_off": "lifts off",
    "jammed": "jams",
    "rim": "rolls past its rim",
}
"""Words for statuses that are no mistakes of the integration."""
OF_TYPE = {
    "D": STOPS,
    "SW": "wobbles on",
    "SS": "spins on",
    "unclassified": "spins on",
}
"""Words for the types of runs whose spin does not reach zero."""
ENDLESS = ("wobbles on", "spins on")
SURE_BELOW = 1e-3  # relative error below which a time is sure
INTERVAL = (0.025, 0.975)
# The last time in a figure, in times of the last event of first reversals and holds.
FIGURE_END = 2.0
WIDEST_FIGURE = 13.0  # inches


def outcomes(runs: pd.DataFrame) -> pd.DataFrame:
    """Return what happens in runs, as columns in SI units.

    The runs have ``record: [reversals]``, and a column `unit_s` with the unit of time
    in s.  A run turns back if its spin goes from beyond a quarter of its first size to
    beyond a quarter on the other side; `t_s` is the first zero on the way.  It hardly
    turns back if it reaches the other side only.
    """
    unit = runs["unit_s"]
    found = pd.DataFrame(index=runs.index)
    found["outcome"] = [_outcome(run) for run in runs.to_dict("records")]
    found["t_s"] = runs["turn_times"].map(_first).fillna(runs["t_r"]) * unit
    found["reversals"] = runs["n_turns"].fillna(0).astype(int)
    found["after_rpm"] = runs["spin_after_turn"].map(_first) / unit * (30 / np.pi)
    never = pd.Series(np.nan, runs.index)
    found["held_s"] = runs.get("t_held", never) * unit
    found["slides_s"] = runs.get("t_slide", never) * unit
    found["end_s"] = runs["t_end"] * unit
    found["status"] = runs["status"]
    return found


def _first(values: Sequence[float] | None) -> float:
    """Return the first of a run's values, NaN if there is none."""
    if values is None or not len(values):
        return np.nan
    return float(values[0])


def _outcome(run: Mapping[Any, Any]) -> str:
    """Return the word for what happens to a spin."""
    if run["n_turns"] > 0:
        return TURNS
    if run["t_r"] > 0:
        return HARDLY
    if run["status"] != "ok":
        return OF_STATUS.get(run["status"], f"{FAILS} ({run['status']})")
    if run.get("t_held", np.nan) > 0:
        return STOPS
    return OF_TYPE[run["type"]]


def judged(found: pd.DataFrame, tighter: pd.DataFrame, tol: float) -> pd.DataFrame:
    """Return the outcomes of the first stone, with how sure they are.

    `found` has the launches of one stone after those of the other, and `tighter` those
    of the first stone at a tolerance that is tighter than `tol`.
    """
    launches = len(tighter)
    table = found.iloc[:launches].copy()
    # Of runs at one tolerance the times are known to it at best.
    error = (table["t_s"] - tighter["t_s"]).abs() + tol * table["t_s"]
    turns = table["outcome"] == TURNS
    agrees = turns == (tighter["outcome"] == TURNS)
    for runs in (table, tighter):
        # A mistake of the integration tells nothing of the stone.
        agrees &= ~runs["outcome"].str.startswith(FAILS)
    table.insert(2, "error_s", error)
    table["sure"] = agrees & ~(turns & ~(error < SURE_BELOW * table["t_s"]))
    drawn = found.iloc[launches:]
    of_turns = drawn["t_s"].where(drawn["outcome"] == TURNS)
    times = of_turns.to_numpy().reshape(-1, launches)
    table["samples"] = len(times)
    for name in ("share", "low_s", "high_s"):
        table[name] = np.nan
    if len(times):
        table["share"] = np.isfinite(times).mean(axis=0)
        table["sure"] &= table["share"] == turns
        for launch in np.flatnonzero(table["share"]):
            its = times[np.isfinite(times[:, launch]), launch]
            table.loc[launch, ["low_s", "high_s"]] = np.quantile(its, INTERVAL)
    return table


def sentence_of(rows: pd.DataFrame, end: float) -> str:
    """Return the verdict in words on launches in two directions, up to a time in s."""
    directions = dict.fromkeys(rows["direction"])
    turning = {*rows["direction"][rows["outcome"] == TURNS]}
    sentences = []
    if not turning:
        sentences.append("Does not turn back.")
    for direction in sorted(directions, key=lambda each: each not in turning):
        clauses = _clauses(rows[rows["direction"] == direction], end)
        sentence = f"Spun {direction} it {clauses}"
        if not sentences:
            sentence = f"Turns back when spun {direction}{clauses.removeprefix(TURNS)}"
        elif turning and direction not in turning and HARDLY not in clauses:
            sentence += " without turning back"
        sentences.append(f"{sentence}.")
    unsure = rows[~rows["sure"]]
    if len(unsure):
        launches = [
            f"{spin:g} rpm {direction}"
            for spin, direction in zip(
                unsure["spin_rpm"], unsure["direction"], strict=True
            )
        ]
        sentences.append(f"Not sure: {joined(launches)}.")
    return " ".join(sentences)


def _clauses(rows: pd.DataFrame, end: float) -> str:
    """Return what happens in one direction, in words; turning back comes first."""
    words = sorted({*rows["outcome"]}, key=lambda word: (word != TURNS, word))
    asked = rows["spin_rpm"].tolist()
    clauses = []
    for word in words:
        its = rows[rows["outcome"] == word]
        clause = word
        if len(words) > 1 or word == TURNS:
            clause += f" at {_spins(its['spin_rpm'].tolist(), asked)}"
        if word in (TURNS, HARDLY):
            clause += f", after {_range(its['t_s'])} s"
        elif word in ENDLESS:
            clause += f" for {end:g} s"
        clauses.append(clause)
    if words[0] != TURNS or len(words) == 1:
        return joined(clauses)
    return f"{clauses[0]}, but {joined(clauses[1:])}"


def _spins(some: Sequence[float], asked: Sequence[float]) -> str:
    """Return spins in words, as a range if they are neighbours among those asked."""
    first = asked.index(some[0])
    if len(some) > 2 and [*some] == [*asked[first : first + len(some)]]:
        return f"{some[0]:g} to {some[-1]:g} rpm"
    return f"{joined([f'{spin:g}' for spin in some])} rpm"


def _range(times: Iterable[float]) -> str:
    low = f"{min(times):#.2g}".rstrip(".")
    high = f"{max(times):#.2g}".rstrip(".")
    return low if low == high else f"{low} to {high}"


def table_as_text(table: pd.DataFrame) -> str:
    """Return the rows of a verdict as aligned text."""
    columns: dict[str, list[str]] = {
        "spun": [],
        "at": [],
        "friction": list(table["friction"]),
        "it": list(table["outcome"]),
        "after": _seconds(_times(table), "#.4g"),
        "error": _seconds(table["error_s"], ".0e"),
        "reversals": list(table["reversals"].astype(str)),
    }
    before: object = None
    for launch in zip(table["direction"], table["spin_rpm"], strict=True):
        cells = ("", "")
        if launch != before:
            cells = (launch[0], f"{launch[1]:g} rpm")
        before = launch
        columns["spun"].append(cells[0])
        columns["at"].append(cells[1])
    # What happens to no launch takes no column.
    for name, head in (("held_s", "held at"), ("slides_s", "slides at")):
        if table[name].notna().any():
            columns[head] = _seconds(table[name], "#.3g")
    columns["sure"] = ["yes" if sure else "no" for sure in table["sure"]]
    if table["samples"].any():
        shares = zip(table["share"], table["samples"], strict=True)
        columns["samples"] = [f"{share * count:.0f}/{count}" for share, count in shares]
        columns["from"] = _seconds(table["low_s"], "#.3g")
        columns["to"] = _seconds(table["high_s"], "#.3g")
    lines = [list(columns), *zip(*columns.values(), strict=True)]
    return align(lines, "<><<>")


def advice_as_text(advice: pd.DataFrame) -> str:
    """Return what would make launches turn back as aligned text."""
    lines = [["what would make it turn back", "spun", "at", "after", "sure"]]
    for row in advice.to_dict("records"):
        sure = "yes" if row["sure"] else "no"
        time = "-" if np.isnan(row["t_s"]) else f"{row['t_s']:#.3g} s"
        spin = f"{row['spin_rpm']:g} rpm"
        lines.append([row["words"], row["direction"], spin, time, sure])
    return align(lines, "<<>")


def _advised(advice: pd.DataFrame | None) -> list[str]:
    """Return the advice as sentences for the caption of a figure."""
    if advice is None:
        return []
    sentences = []
    for row in advice.to_dict("records"):
        launch = f"spun {row['direction']}"
        sentence = row["words"]
        if row["change"] != "spin":
            launch += f" at {row['spin_rpm']:g} rpm"
            sentence += " would turn it back"
        sentences.append(f"{launch[:1].upper()}{launch[1:]}, {sentence}.")
    return sentences


def _times(table: pd.DataFrame) -> pd.Series[float]:
    """Return the times of outcomes, NaN for a spin that goes on to the end."""
    times = table["t_s"].fillna(table["held_s"])
    return times.fillna(table["end_s"].where(table["status"] != "ok"))


def _seconds(values: pd.Series[float], form: str) -> list[str]:
    return ["-" if np.isnan(value) else f"{value:{form}} s" for value in values]


class SpinCurve(NamedTuple):
    """The spin of a run over time, in s and rpm."""

    friction: str
    n_i_rpm: float
    t_s: Floats
    n_rpm: Floats


DOT = "A dot is the first reversal."
NOT_SURE = (
    "Not sure: a stone within the errors that were given, or the same one with a "
    "tighter tolerance, does something else."
)


def draw_verdict(
    table: pd.DataFrame,
    curves: Sequence[SpinCurve],
    sentence: str,
    path: str | Path | None = None,
    advice: pd.DataFrame | None = None,
) -> Figure:
    """Return a figure of the spins of a verdict over time, a panel for each launch.

    A dot is the first reversal.  The caption says what would make it turn back.
    """
    directions = list(dict.fromkeys(table["direction"]))
    spins = list(dict.fromkeys(table["spin_rpm"]))
    frictions = list(dict.fromkeys(table["friction"]))
    colours = {NO_FRICTION: SILVER, frictions[-1]: BLUE}
    end = max(curve.t_s[-1] for curve in curves)
    events = table[["t_s", "held_s"]].max().max()
    if np.isfinite(events):
        end = min(end, FIGURE_END * events)
    with style.styled():
        width = min(1.4 + 2.6 * len(spins), WIDEST_FIGURE)
        figure = room.usual_figure(width, 0.9 + 1.9 * len(directions))
        shape = len(directions), len(spins)
        panels = figure.subplots(*shape, sharex=True, sharey="col", squeeze=False)
        of_launch = {}
        for row, direction in enumerate(directions):
            panels[row, 0].set_ylabel(f"spun {direction}\nspin (rpm)")
            for axes, spin in zip(panels[row], spins, strict=True):
                of_launch[SIGN_OF_DIRECTION[direction] * spin] = axes
                style.light_grid(axes)
                axes.axhline(0, color=INK, linewidth=0.6, zorder=1)
                axes.set_title(f"{spin:g} rpm", loc="left", fontsize=9)
        for axes in panels[-1]:
            axes.set(xlim=(0, end), xlabel="time (s)")
        notes = []
        for curve in curves:
            axes = of_launch[curve.n_i_rpm]
            if style.curve(axes, curve.t_s, curve.n_rpm, colours[curve.friction]):
                notes = [style.BAND]
        if table["t_s"].notna().any():
            notes.append(DOT)
        if not table["sure"].all():
            notes.append(NOT_SURE)
        rows: list[dict[Any, Any]] = table.to_dict("records")
        for launch, time in zip(rows, _times(table), strict=True):
            axes = of_launch[
                SIGN_OF_DIRECTION[launch["direction"]] * launch["spin_rpm"]
            ]
            colour = colours[launch["friction"]]
            axes.plot(
                launch["t_s"], 0, "o", color=colour, markeredgecolor="white", zorder=5
            )
            if launch["friction"] == frictions[-1]:
                label = launch["outcome"]
                if np.isfinite(time):
                    label += f" after {_range([time])} s"
                axes.set_title(label, loc="right", fontsize=9, color=BLUE)
        handles = []
        for friction in frictions:
            words = f"with {friction}"
            if friction == NO_FRICTION:
                words = "without friction"
            look = {"color": colours[friction], "linestyle": "-"}
            handles.append(style.entry(words, marker="o", **look))
        style.add_legend(figure, handles, [sentence.replace(". ", ".\n")])
        style.add_caption(figure, [*_advised(advice), *notes])
        return shown(figure, path)
