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
import pyarrow as pa
import pyarrow.compute as pc
from ruamel.yaml import YAML

from rattlesweep.paper.columns import count, number, schema, word
from rattlesweep.sweeps.counts import wilson

Tables = Mapping[str, Mapping[str, pa.Table]]
# Checks, whose truth says whether they hold, and numbers by name.
Measured = tuple[Sequence[object], dict[str, Any]]

CLAIMS = schema(
    "",
    word("id", "T: theory, G: the body GH, U: unsteady direction, S: steady, L: long runs"),
    word("where", "place in the paper"),
    word("words", "what the paper says; word for word between quotation marks"),
    word("measured", "what was found"),
    number("value", "the figure that decides, where there is one"),
    number("low", "lower end of its 95 % confidence interval, or of its range"),
    number("high", "upper end of the same"),
    word("verdict", "agree: all checks hold; disagree: the headline fails; partly: another one "
         "does, or the headline at one in ten at most where the paper's words leave room"),
    count("held", "number of checks that hold"),
    count("checks", "number of checks"),
    word("headline", "the check without which nothing is left of the claim"),
    word("evidence", "all checks, and how they were made"),
)  # fmt: skip
TABLE = Path(__file__).with_name("claims.yaml")
# Rounding error allowed in an identity between doubles.
EXACT = 1e-9
# Share at which a headline must hold where the paper's words leave room, for `partly`.
MOST = 0.9


@dataclass(frozen=True)
class Count:
    """How many of a total meet a criterion; true if all do, and there are any."""

    hits: int
    total: int

    def __bool__(self) -> bool:
        return 0 < self.hits == self.total

    def __add__(self, other: Count) -> Count:
        return Count(self.hits + other.hits, self.total + other.total)

    def __str__(self) -> str:
        return f"{self.hits:,} of {self.total:,}"


def every(mask: Any) -> Count:
    """Count of the true values."""
    return Count(int(np.sum(mask)), len(mask))


def share(hits: int, runs: int) -> dict[str, float]:
    """Share with its interval, as the numbers that decide a claim."""
    low, high = map(float, wilson(hits, runs))
    return {"value": hits / runs if runs else np.nan, "low": low, "high": high}


def share_words(hits: int, runs: int) -> str:
    """Share with its interval, in words."""
    return "{value:.2%} [{low:.2%}, {high:.2%}]".format(**share(hits, runs))


def complete(figure: Mapping[str, pa.Table]) -> bool:
    """Whether all points of the figure's sweep have runs of status ok: others settle nothing."""
    points = figure.get("times", figure.get("fractions"))
    return points is None or pc.min(points["runs"]).as_py() > 0


@dataclass(frozen=True, kw_only=True)
class Claim:
    """A row of the table of claims."""

    id: str  # T1, U2, ...
    where: str
    """Place in the paper; equations by their printed number and their label in the source, as in
    ``Eq. (38) [k-diff]``."""
    words: str  # of the paper, between quotation marks word for word
    criteria: Sequence[str]
    """What is asked of the measurement, first the headline: the paper's statement itself."""
    measure: Callable[..., Measured | None]
    """From the tables of the figures to the checks, one for each criterion, and the numbers; None
    if these tables cannot settle the claim.  Of the numbers, ``value`` is the one that decides,
    ``low`` and ``high`` its confidence interval or range."""
    measured: str  # what was found, with numbers in braces
    notes: str = ""  # likewise, how it was found, and what explains it
    lists: Mapping[str, tuple[str, str]] = field(default_factory=dict)
    """Of a number that is rows: what stands between them, and the words of one."""
    leeway: str = ""  # the paper's word that leaves room in the headline, such as “almost”
    figures: Sequence[str] = ()  # whose tables are needed; none for a claim about formulas alone

    def judge(self, tables: Tables, **options: Any) -> dict[str, Any] | None:
        """Measure the claim: a row of :data:`CLAIMS`, or None if these tables cannot settle it.

        A headline that fails makes it ``disagree``; where the paper's words leave room, and nine in
        ten still meet the headline, ``partly``.
        """
        if not all(complete(tables.get(name, {})) for name in self.figures):
            return None
        found = self.measure(tables, **options)
        if found is None:
            return None
        checks, numbers = found
        for name, (between, words) in self.lists.items():
            numbers[name] = between.join(words.format(**row) for row in numbers[name])
        told = [
            f"{words}: {'yes' if check else 'no'}"
            + (f", {check}" if isinstance(check, Count) else "")
            for words, check in zip(self.criteria, checks, strict=True)
        ]
        notes = self.notes.format(**numbers).strip()
        head, held = checks[0], sum(map(bool, checks))
        room = self.leeway and isinstance(head, Count) and head.hits >= MOST * head.total > 0
        if room and not head:
            notes = f"The headline fails, but the paper's words leave room: {self.leeway}. {notes}"
        decides = {name: numbers.get(name) for name in ("value", "low", "high")}
        return {
            "id": self.id,
            "where": self.where,
            "words": self.words,
            "measured": self.measured.format(**numbers),
            **{n: v if v is None or math.isfinite(v) else None for n, v in decides.items()},
            "verdict": "agree" if held == len(checks) else "partly" if head or room else "disagree",
            "held": held,
            "checks": len(checks),
            "headline": self.criteria[0],
            "evidence": f"Checks, headline first: {'; '.join(told)}. {notes}".strip(),
        }


@cache
def claims() -> dict[str, Claim]:
    """The claims of ``claims.yaml`` by their id."""
    found = {}
    for name, row in YAML(typ="safe").load(TABLE).items():
        module, function = row.pop("measure").split(".")
        measure = getattr(import_module(f"{__package__}.{module}"), function)
        found[name] = Claim(id=name, measure=measure, **row)
    return found


def judge(tables: Tables, *, theory: bool) -> list[dict[str, Any]]:
    """Rows of the claims that the tables of these figures, and ``theory`` alone, can settle."""
    able = [c for c in claims().values()
            if (tables.keys() >= set(c.figures) if c.figures else theory)]  # fmt: skip
    return [found for claim in able if (found := claim.judge(tables)) is not None]
