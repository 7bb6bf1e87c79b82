"""The claims of the paper: measurements, criteria and verdicts."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from pkgutil import resolve_name
from typing import Any, TypedDict

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from ruamel.yaml import YAML

from rattlesweep.api import wilson
from rattlesweep.paper.workspace import Made

# What a measure returns: checks, each true if it holds, and numbers by name.
Measured = tuple[Sequence[object], dict[str, Any]]

UNDECIDED = "too few samples to tell"
# Rounding error allowed in an identity between doubles.
ROUNDING_ALLOWED = 1e-9
# Share of its cases in which a headline must hold for `partly`, if the paper's words
# leave room.
_MOST = 0.9


@dataclass(frozen=True)
class Tally:
    """How many meet a criterion; true if all do, and if there are any.

    The ``unsure`` ones fail, but by less than their sampling error.
    """

    hits: int
    total: int
    unsure: int = 0

    def __bool__(self) -> bool:
        return 0 < self.hits == self.total

    def __add__(self, other: Tally) -> Tally:
        return Tally(
            self.hits + other.hits, self.total + other.total, self.unsure + other.unsure
        )

    def __str__(self) -> str:
        return f"{self.hits:,} of {self.total:,}"


def every(mask: ArrayLike, possible: ArrayLike = False) -> Tally:
    """Count true values, and the false ones that `possible` says may be true."""
    holds = np.asarray(mask, dtype=bool)
    unsure = ~holds & np.asarray(possible, dtype=bool)
    return Tally(int(holds.sum()), holds.size, int(unsure.sum()))


def rises(
    frame: pd.DataFrame, value: str, by: str, within: Sequence[str], *, sign: int = 1
) -> Tally:
    """Count the groups in which a value rises (with sign -1, falls) with a column.

    The rows of a group are equal in the columns ``within``, and ordered by abs(``by``).
    Groups of one row do not count.  A group that fails is unsure if the intervals of
    its values, ``value_low`` to ``value_high``, still allow each step to rise.
    """
    columns = [value, f"{value}_low", f"{value}_high"]
    rising = []
    possible = []
    for _, group in frame.groupby(list(within)):
        if len(group) < 2:
            continue
        ordered = group.sort_values(by, key=np.abs)[columns]
        values, *ends = (sign * ordered).to_numpy().T
        # With the sign -1, the lower end has become the upper one.
        low, high = np.sort(ends, axis=0)
        steps = np.diff(values)
        up = steps > 0
        if sign < 0:  # a value that stays the same counts as one that falls
            up = steps >= 0
        rising.append(up.all())
        possible.append((up | (high[1:] > low[:-1])).all())
    return every(rising, possible)


class Share(TypedDict):
    """A share, its 95 % interval, and all three as text."""

    value: float
    low: float
    high: float
    share: str


def share_and_text(hits: int, runs: int) -> Share:
    """Return a share and its 95 % interval as numbers, and as the text ``share``."""
    low, high = map(float, wilson(hits, runs))
    value = np.nan
    if runs:
        value = hits / runs
    text = f"{value:.2%} [{low:.2%}, {high:.2%}]"
    return {"value": value, "low": low, "high": high, "share": text}


def extremes(values: Collection[float]) -> tuple[float, float]:
    """Return the smallest and the largest value."""
    return min(values), max(values)


@cache
def read_rows_of(name: str) -> dict[str, dict[str, Any]]:
    """Return the rows of ``NAME.yaml`` by id, with names of functions resolved."""
    path = Path(__file__).with_name(f"{name}.yaml")
    rows: dict[str, dict[str, Any]] = YAML(typ="safe").load(path)
    for row in rows.values():
        for key in row.keys() & {"measure", "data", "draw"}:
            row[key] = resolve_name(f"rattlesweep.paper.{row[key]}")
    return rows


def judge(made: Made, *, theory: bool, few: bool = False) -> list[dict[str, Any]]:
    """Judge the claims whose parts were made, and with `theory` those about formulas.

    The latter have no parts.  `few` says that the sweeps have fewer samples than a full
    reproduction, so that a check may fail by chance.
    """
    judged = []
    for name, claim in read_rows_of("claims").items():
        can_judge = theory
        if "parts" in claim:
            can_judge = made.keys() >= set(claim["parts"])
        if can_judge:
            judged.append({"id": name} | judge_claim(claim, made, few))
    return judged


def judge_claim(claim: Mapping[str, Any], made: Made, few: bool) -> dict[str, Any]:
    """Measure a claim, a row of ``claims.yaml``, and return the rest of a row of the
    table.

    Its function ``measure`` returns checks, one for each of the ``criteria``, and
    numbers by name; or None, if there are too few samples.  The first criterion is the
    headline.  Of the numbers, the table has ``value``, and its interval from ``low`` to
    ``high``.
    """
    criteria = claim["criteria"]
    row = {
        "where": claim["where"],
        "words": claim["words"],
        "headline": criteria[0],
        "checks": len(criteria),
        **dict.fromkeys(("value", "low", "high")),
    }
    measurement = claim["measure"](made)
    if measurement is None:
        return row | {
            "measured": "not measured: too few runs of a kind",
            "verdict": UNDECIDED,
            "held": 0,
            "evidence": "",
        }
    checks, numbers = measurement
    # Some numbers are lists of rows, which the claim's own format makes into text.
    for name, (between, form) in claim.get("lists", {}).items():
        numbers[name] = between.join(form.format(**entry) for entry in numbers[name])
    sentences = list(map(_answer, criteria, checks))
    leeway = claim.get("leeway", "")
    verdict = verdict_of(checks, few, leeway=bool(leeway))
    if verdict == "partly" and not checks[0]:
        sentences.append(
            f"the headline fails, but the paper's words leave room: {leeway}"
        )
    notes = claim.get("notes", "").format(**numbers)
    values = {name: numbers.get(name) for name in ("value", "low", "high")}
    return row | {
        "measured": claim["measured"].format(**numbers),
        "verdict": verdict,
        "held": sum(map(bool, checks)),
        "evidence": f"Checks, headline first: {'; '.join(sentences)}. {notes}".strip(),
        **{
            k: float(v) for k, v in values.items() if v is not None and math.isfinite(v)
        },
    }


def _answer(criterion: str, check: object) -> str:
    """Return a criterion with its answer, and with the count if there is one."""
    answer = "yes" if check else "no"
    if isinstance(check, Tally):
        answer = f"{answer}, {check}"
    return f"{criterion}: {answer}"


def verdict_of(checks: Sequence[object], few: bool, leeway: bool) -> str:
    """Return the verdict on a claim.

    It *agrees* if all checks hold, and *disagrees* if the headline fails; else it holds
    *partly*, as it does where the paper's words leave room and nine in ten meet the
    headline.  With ``few`` samples there are *too few samples to tell* if all checks
    that fail, or the headline, may hold within their sampling error.
    """
    head = checks[0]
    possible = [bool(check) or (few and _may_hold(check)) for check in checks]
    if all(checks):
        return "agree"
    if all(possible) or (possible[0] and not head):
        return UNDECIDED
    most = isinstance(head, Tally) and head.hits >= _MOST * head.total > 0
    if head or (leeway and most):
        return "partly"
    return "disagree"


def _may_hold(check: object) -> bool:
    """Return whether a count that fails may hold within its sampling error."""
    return isinstance(check, Tally) and check.hits + check.unsure == check.total
