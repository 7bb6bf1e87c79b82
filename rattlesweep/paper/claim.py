"""The claims of the paper: measurements, criteria and verdicts."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from pkgutil import resolve_name
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from ruamel.yaml import YAML

from rattlesweep.paper.workspace import Made
from rattlesweep.sweeps.types import wilson

# Checks, each true if it holds, and numbers by name.
Measured = tuple[Sequence[object], dict[str, Any]]

UNDECIDED = "too few samples to tell"
# Rounding error allowed in an identity between doubles.
EXACT = 1e-9
# Fraction of a headline that must hold for `partly` if the paper's words leave room.
MOST = 0.9


@dataclass(frozen=True)
class Count:
    """How many meet a criterion, and how many fail within their error."""

    hits: int
    total: int
    unsure: int = 0

    def __bool__(self) -> bool:
        return 0 < self.hits == self.total

    def __add__(self, other: Count) -> Count:
        return Count(
            self.hits + other.hits,
            self.total + other.total,
            self.unsure + other.unsure,
        )

    def __str__(self) -> str:
        return f"{self.hits:,} of {self.total:,}"


def every(
    mask: ArrayLike | pd.Series, possible: ArrayLike | pd.Series = False
) -> Count:
    """Count the true values, and the false ones that are `possible` within error."""
    holds = np.asarray(mask, dtype=bool)
    unsure = ~holds & np.asarray(possible, dtype=bool)
    return Count(int(holds.sum()), holds.size, int(unsure.sum()))


def rises(
    frame: pd.DataFrame, value: str, by: str, within: Sequence[str], *, sign: int = 1
) -> Count:
    """Count the groups in which `value` rises with abs(``by``); with sign -1, falls."""
    columns = [value, f"{value}_low", f"{value}_high"]
    rising = []
    possible = []
    for _, group in frame.groupby(list(within)):
        if len(group) < 2:
            continue
        ordered = sign * group.sort_values(by, key=np.abs)[columns].to_numpy()
        steps = np.diff(ordered[:, 0])
        # Equal neighbours are no rise, but no contradiction to a fall.
        up = steps > 0 if sign > 0 else steps >= 0
        low, high = np.sort(ordered[:, 1:], axis=1).T
        rising.append(up.all())
        possible.append((up | (high[1:] > low[:-1])).all())
    return every(rising, possible)


def share(hits: int, runs: int) -> dict[str, Any]:
    """Return a share and its 95 % interval as numbers, and as the text ``share``."""
    low, high = map(float, wilson(hits, runs))
    value = hits / runs if runs else np.nan
    text = f"{value:.2%} [{low:.2%}, {high:.2%}]"
    return {"value": value, "low": low, "high": high, "share": text}


def span(values: Iterable[Any]) -> tuple[Any, Any]:
    """Return the smallest and the largest value."""
    values = list(values)
    return min(values), max(values)


@cache
def read_table(name: str) -> dict[str, dict[str, Any]]:
    """Return the rows of ``NAME.yaml`` by their id, with their functions."""
    path = Path(__file__).with_name(f"{name}.yaml")
    rows: dict[str, dict[str, Any]] = YAML(typ="safe").load(path)
    for row in rows.values():
        for key in row.keys() & {"measure", "data", "draw"}:
            row[key] = resolve_name(f"rattlesweep.paper.{row[key]}")
    return rows


def judge(made: Made, *, theory: bool, few: bool = False) -> list[dict[str, Any]]:
    """Judge the claims whose parts were made and, with `theory`, those on formulas."""
    judged = []
    for name, claim in read_table("claims").items():
        is_ready = theory
        if "parts" in claim:
            is_ready = made.keys() >= set(claim["parts"])
        if is_ready:
            judged.append({"id": name} | judge_claim(claim, made, few))
    return judged


def judge_claim(claim: Mapping[str, Any], made: Made, few: bool) -> dict[str, Any]:
    """Measure a claim, a row of ``claims.yaml``, and return the rest of a row of the
    table.

    Its function ``measure`` takes the tables to checks, one for each of the
    ``criteria``, of which the first is the headline, and to numbers by name (or to
    None: too few samples).  Of these ``value`` decides, and ``low`` to ``high`` is its
    interval.
    """
    criteria = claim["criteria"]
    row: dict[str, Any] = {
        "where": claim["where"],
        "words": claim["words"],
        "headline": criteria[0],
        "checks": len(criteria),
        "value": None,
        "low": None,
        "high": None,
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
    for name, (between, form) in claim.get("lists", {}).items():
        numbers[name] = between.join(form.format(**entry) for entry in numbers[name])
    evidence = [
        f"{criterion}: {_answer(check)}"
        for criterion, check in zip(criteria, checks, strict=True)
    ]
    leeway = claim.get("leeway", "")
    verdict = verdict_of(checks, few, leeway=bool(leeway))
    if verdict == "partly" and not checks[0]:
        evidence.append(
            f"the headline fails, but the paper's words leave room: {leeway}"
        )
    notes = claim.get("notes", "").format(**numbers)
    for name in ("value", "low", "high"):
        number = numbers.get(name)
        if number is not None and math.isfinite(number):
            row[name] = float(number)
    return row | {
        "measured": claim["measured"].format(**numbers),
        "verdict": verdict,
        "held": sum(map(bool, checks)),
        "evidence": f"Checks, headline first: {'; '.join(evidence)}. {notes}".strip(),
    }


def _answer(check: object) -> str:
    """Return whether a check holds, and for how many, as text."""
    answer = "yes" if check else "no"
    if isinstance(check, Count):
        answer += f", {check}"
    return answer


def verdict_of(checks: Sequence[object], few: bool, leeway: bool) -> str:
    """Return the verdict on a claim.

    It *agrees* if all checks hold, and *disagrees* if the headline fails; else it holds
    *partly*, as it does where the paper's words leave room and nine in ten meet the
    headline.  With ``few`` samples, failing checks within their error leave *too few
    samples to tell*.
    """
    head = checks[0]
    if all(checks):
        return "agree"
    possible = [_is_possible(check, few) for check in checks]
    if all(possible) or (possible[0] and not head):
        return UNDECIDED
    most = isinstance(head, Count) and head.hits >= MOST * head.total > 0
    if head or (leeway and most):
        return "partly"
    return "disagree"


def _is_possible(check: object, few: bool) -> bool:
    """Return whether a check holds, or with few samples may hold within their error."""
    if few and isinstance(check, Count):
        return bool(check) or check.hits + check.unsure == check.total
    return bool(check)
