"""A claim of the paper: its words, what is asked of the measurement, and the verdict."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from ruamel.yaml import YAML

from rattlesweep.paper.workspace import Made
from rattlesweep.sweeps.types import wilson

# Checks, whose truth says whether they hold, and numbers by name.
Measured = tuple[Sequence[object], dict[str, Any]]

COLUMNS = ["id", "where", "words", "measured", "value", "low", "high", "verdict", "held", "checks",
           "headline", "evidence"]  # fmt: skip
UNDECIDED = "too few samples to tell"
TABLE = Path(__file__).with_name("claims.yaml")
# Rounding error allowed in an identity between doubles.
EXACT = 1e-9
# Share at which a headline must hold where the paper's words leave room, for `partly`.
MOST = 0.9


@dataclass(frozen=True)
class Count:
    """Number that meet a criterion; true if all do.  ``unsure`` others miss it within error."""

    hits: int
    total: int
    unsure: int = 0

    def __bool__(self) -> bool:
        return 0 < self.hits == self.total

    def __add__(self, other: Count) -> Count:
        return Count(self.hits + other.hits, self.total + other.total, self.unsure + other.unsure)

    def __str__(self) -> str:
        return f"{self.hits:,} of {self.total:,}"


def every(mask: Any, possible: Any = False) -> Count:
    """Count the true values; of the others, those that are possible within sampling error."""
    mask = np.asarray(mask, dtype=bool)
    return Count(int(mask.sum()), mask.size, int((~mask & np.asarray(possible, bool)).sum()))


def share(hits: int, runs: int) -> dict[str, Any]:
    """Return a share with its 95 % interval: the numbers that decide a claim, and as ``share``."""
    low, high = map(float, wilson(hits, runs))
    value = hits / runs if runs else np.nan
    words = f"{value:.2%} [{low:.2%}, {high:.2%}]"
    return {"value": value, "low": low, "high": high, "share": words}


@dataclass(frozen=True, kw_only=True)
class Claim:
    """A row of the table of claims.

    `words` is what the paper says; `criteria` is what is asked of the measurement, first the
    headline.  `measure` takes the tables of `parts` to the checks, one for each criterion, and to
    numbers by name (None: too few samples), of which ``value`` decides and ``low`` to ``high`` is
    its interval.  `measured` and `notes` are texts with numbers in braces; `lists` has, for a
    number that is rows, what stands between them and the words of one; `leeway` is the paper's word
    that leaves room in the headline.
    """

    id: str
    where: str
    words: str
    criteria: Sequence[str]
    measure: Callable[..., Measured | None]
    measured: str
    notes: str = ""
    lists: Mapping[str, tuple[str, str]] = field(default_factory=dict)
    leeway: str = ""
    parts: Sequence[str] = ()

    def judge(self, made: Made, *, few: bool = False) -> dict[str, Any]:
        """Measure the claim and return a row of the table, with the columns :data:`COLUMNS`."""
        row = {"id": self.id, "where": self.where, "words": self.words,
               "headline": self.criteria[0], "checks": len(self.criteria)}  # fmt: skip
        found = self.measure(made)
        if found is None:
            words = "not measured: too few runs of a kind"
            return dict.fromkeys(COLUMNS) | row | {
                "measured": words, "verdict": UNDECIDED, "held": 0, "evidence": "",
            }  # fmt: skip
        checks, numbers = found
        for name, (between, words) in self.lists.items():
            numbers[name] = between.join(words.format(**own) for own in numbers[name])
        told = [
            f"{words}: {'yes' if check else 'no'}"
            + (f", {check}" if isinstance(check, Count) else "")
            for words, check in zip(self.criteria, checks, strict=True)
        ]
        verdict, room = self.verdict(checks, few)
        if room:
            told.append(f"the headline fails, but the paper's words leave room: {self.leeway}")
        for name in ("value", "low", "high"):
            value = numbers.get(name)
            row[name] = float(value) if value is not None and math.isfinite(value) else None
        evidence = f"Checks, headline first: {'; '.join(told)}. {self.notes.format(**numbers)}"
        return row | {
            "measured": self.measured.format(**numbers),
            "verdict": verdict,
            "held": sum(map(bool, checks)),
            "evidence": evidence.strip(),
        }

    def verdict(self, checks: Sequence[object], few: bool) -> tuple[str, bool]:
        """Return the verdict, and whether it is due to the leeway.

        The claim *agrees* if all checks hold, and *disagrees* if the headline fails; else it holds
        *partly*, as it does where the paper's words leave room and nine in ten meet the headline.
        With ``few`` samples, failing checks within their error leave *too few samples to tell*.
        """
        head = checks[0]
        possible = [
            bool(c) or (few and isinstance(c, Count) and c.hits + c.unsure == c.total)
            for c in checks
        ]
        if all(checks):
            return "agree", False
        if all(possible) or (possible[0] and not head):
            return UNDECIDED, False
        enough = isinstance(head, Count) and head.hits >= MOST * head.total > 0
        room = bool(self.leeway) and enough and not head
        return "partly" if head or room else "disagree", room


def read_table(name: str) -> dict[str, dict[str, Any]]:
    """Return the rows of ``NAME.yaml`` by their id, with the functions that they name."""
    rows: dict[str, dict[str, Any]] = YAML(typ="safe").load(TABLE.with_name(f"{name}.yaml"))
    for row in rows.values():
        for key in row.keys() & {"measure", "data", "draw"}:
            module, function = row[key].split(".")
            row[key] = getattr(import_module(f"rattlesweep.paper.{module}"), function)
    return rows


@cache
def claims() -> dict[str, Claim]:
    """Return the claims of ``claims.yaml`` by their id."""
    return {name: Claim(id=name, **row) for name, row in read_table("claims").items()}


def judge(made: Made, *, theory: bool, few: bool = False) -> list[dict[str, Any]]:
    """Return rows of the claims whose parts were made, and of those about formulas alone."""
    return [
        claim.judge(made, few=few) for claim in claims().values()
        if (made.keys() >= set(claim.parts) if claim.parts else theory)
    ]  # fmt: skip
