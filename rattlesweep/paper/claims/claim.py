"""A row of the claims table: what the paper says, what was measured, which checks hold."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

# Rounding error allowed in an identity between doubles.
EXACT = 1e-9

Verdict = Literal["agree", "partly", "disagree"]
Checks = Sequence[tuple[str, bool]]


@dataclass(frozen=True, kw_only=True)
class Claim:
    """What the paper says, and what was measured.

    Attributes
    ----------
    id : str
        ``T1``, ``U2``, ...
    where : str
        Place in the paper; equations by their printed number and their label in the source, as in
        ``Eq. (38) [k-diff]``.
    words : str
        What the paper says.  What stands between quotation marks is quoted word for word.
    measured : str
        What was found, with its figures.
    checks : sequence of (str, bool)
        What was asked of the measurement, and whether it holds.  The first is the headline: the
        statement without which nothing is left of the claim.
    notes : str
        How the claim was checked, and what explains the outcome.
    value, low, high : float, optional
        The figure that decides, and its confidence interval or its range, where there is one.
    """

    id: str
    where: str
    words: str
    measured: str
    checks: Checks
    notes: str = ""
    value: float | None = None
    low: float | None = None
    high: float | None = None

    @property
    def held(self) -> int:
        """Number of checks that hold."""
        return sum(holds for _, holds in self.checks)

    @property
    def verdict(self) -> Verdict:
        """``agree`` if all checks hold, ``disagree`` if the headline fails, else ``partly``."""
        if self.held == len(self.checks):
            return "agree"
        return "partly" if self.checks[0][1] else "disagree"

    @property
    def score(self) -> str:
        """Such as ``3 of 4``."""
        return f"{self.held} of {len(self.checks)}"

    @property
    def evidence(self) -> str:
        """The checks in words, the headline first, and the notes."""
        said = "; ".join(f"{words}: {'yes' if holds else 'no'}" for words, holds in self.checks)
        return f"Checks, headline first: {said}. {self.notes}".strip()


def wilson(hits: int, runs: int, z: float = 1.959964) -> tuple[float, float]:
    """Wilson's interval for a share, 95 % unless ``z`` says otherwise.

    Parameters
    ----------
    hits, runs : int
        ``0 <= hits <= runs``, ``runs > 0``.
    z : float
        Normal quantile.

    Raises
    ------
    ValueError
        If there are no runs, or more hits than runs.
    """
    if not 0 <= hits <= runs or not runs:
        raise ValueError(f"no share has {hits} hits in {runs} runs")
    share, weight = hits / runs, z * z / runs
    middle = (share + weight / 2) / (1 + weight)
    half = z / (1 + weight) * math.sqrt((share * (1 - share) + weight / 4) / runs)
    # The ends are exactly 0 and 1 where all runs are of one kind.
    return (0.0 if hits == 0 else middle - half), (1.0 if hits == runs else middle + half)
