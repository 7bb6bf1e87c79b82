"""A row of the claims table, and what verdicts are made of."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

# What rounding may leave of an identity between doubles.
EXACT = 1e-9

Verdict = Literal["agree", "partly", "disagree"]


@dataclass(frozen=True, kw_only=True)
class Claim:
    """What the paper says, and what was measured.

    Attributes
    ----------
    id : str
        ``T1``, ``U2``, ...
    where : str
        Place in the paper.
    words : str
        The paper's own words, in brief.
    measured : str
        What was found, with its figures.
    value, low, high : float, optional
        The figure that decides, and its confidence interval or its range, where there is one.
    verdict : {"agree", "partly", "disagree"}
        Follows from the measurement by the criterion that ``evidence`` states.
    evidence : str
        How it was checked, and by which criterion it was judged.
    """

    id: str
    where: str
    words: str
    measured: str
    verdict: Verdict
    evidence: str
    value: float | None = None
    low: float | None = None
    high: float | None = None


def judge(whole: bool, part: bool = False) -> Verdict:
    """``agree`` if all of a claim holds, ``partly`` if a part of it does, else ``disagree``."""
    if whole:
        return "agree"
    return "partly" if part else "disagree"


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
