"""The table of claims: how a verdict is made, measures on made-up tables, the paper's
own words.
"""

from __future__ import annotations

import math
import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from rattlesweep.paper.claim import (
    UNDECIDED,
    Tally,
    every,
    judge,
    judge_claim,
    read_rows_of,
)
from rattlesweep.paper.fig6_8 import times
from rattlesweep.paper.reproduce import verdict_table

ROOT = Path(__file__).parents[2]
PAPER = ROOT / "rattlesweep" / "paper"
CLAIMS = read_rows_of("claims")
PARTS = read_rows_of("parts")


def judgement(*checks, few=False, **numbers):
    """Judge a claim that was checked so."""
    criteria = [f"check {k}" for k in range(len(checks))]
    claim = {
        "where": "",
        "words": "words",
        "criteria": criteria,
        "measured": "measured",
        "notes": "End.",
        "measure": lambda made: (checks, numbers),
    }
    return {"id": "T1"} | judge_claim(claim, {}, few)


def test_a_verdict_is_made_of_checks_the_first_of_which_is_the_headline():
    cases = ((True, True), (True, False), (False, True))
    assert [judgement(*c)["verdict"] for c in cases] == ["agree", "partly", "disagree"]
    claim = judgement(True, Tally(2, 3), every([True, True]), value=math.nan)
    assert claim["evidence"] == (
        "Checks, headline first: check 0: yes; check 1: no, 2 of 3; "
        "check 2: yes, 2 of 2. End."
    )
    assert (claim["held"], claim["checks"], claim["headline"]) == (2, 3, "check 0")
    assert claim["value"] is None
    assert verdict_table([claim]) == "T1   partly (2 of 3): words\n     found: measured"


def test_few_samples_cannot_tell_what_lies_within_their_error():
    within = Tally(8, 10, unsure=2)
    beyond = Tally(8, 10, unsure=1)
    # With the paper's own number of samples a check that fails has failed.
    assert [judgement(True, c)["verdict"] for c in (within, beyond)] == ["partly"] * 2
    verdicts = [
        judgement(True, c, few=True)["verdict"] for c in (within, beyond, True, False)
    ]
    assert verdicts == [UNDECIDED, "partly", "agree", "partly"]
    assert judgement(within, False, few=True)["verdict"] == UNDECIDED
    assert judgement(beyond, True, few=True)["verdict"] == "disagree"
    nothing = judge_claim(CLAIMS["T1"] | {"measure": lambda made: None}, {}, few=False)
    assert nothing["verdict"] == UNDECIDED


def test_every_claim_is_one_row():
    listed = (
        "T1 T2 T3 T4 T5 T6 T7 T8 G1 G2 G3 U1 U2 S1 S2 S3 S4 S5 S6 S7 S8 S9 S9b C1 "
        "L1 L2 L3 L4"
    )
    assert list(CLAIMS) == listed.split()
    assert {
        name for claim in CLAIMS.values() for name in claim.get("parts", ())
    } == set(PARTS)
    assert judge({}, theory=False) == []


def u1(ratio=1.0, scatter=0.01, **options):
    """Judge U1 by runs on the line, times ``ratio``."""
    axes = np.meshgrid([0.1, 0.3, 1.0], [0.1, 0.2, 0.5], [0.001, 0.01, 0.1])
    k, n, w = (np.repeat(axis.ravel(), 9) for axis in axes)
    n_0 = np.hypot(n, w)
    t_r = ratio * 2 * np.arctanh(n / n_0) / (n_0 * k)
    spread = np.tile(
        np.linspace(-1, 1, 9) / np.linspace(-1, 1, 9).std(ddof=1), len(k) // 9
    )
    runs = pd.DataFrame(
        {
            "case": np.arange(len(k)) // 9,
            "K_p": k,
            "n_i": n,
            "omega_xy0": w,
            "n_0": n_0,
            "type": "R",
            "t_r": t_r * (1 + scatter * spread),
        }
    )
    made = {"fig6": {"times": times(runs, "K_p")}}
    return judge_claim(CLAIMS["U1"], made, options.get("few", False))


def test_verdicts_follow_the_measurement():
    assert u1()["verdict"] == "agree"
    off = u1(ratio=2.0)
    # The slopes and the scatter are as they should be; of the headline nothing is left.
    assert (off["verdict"], off["held"], off["checks"]) == ("disagree", 2, 3)
    assert off["value"] == pytest.approx(2.0)
    assert u1(scatter=0.9)["verdict"] == "partly"
    assert u1(ratio=1.3, scatter=0.08, few=True)["verdict"] == UNDECIDED
    assert u1(ratio=1.3, scatter=0.08)["verdict"] == "disagree"


EXCERPTS = Path(__file__).with_name("paper_excerpts.tex").read_text()
WORDS = {
    "lesssim": "<~",
    "gtrsim": ">~",
    "approx": "~",
    "ll": "<<",
    "gg": ">>",
    "le": "<=",
    "circ": "deg",
}


def plain(text, *, tex=False):
    """Return text without spaces, its mathematics spelt as in the claims."""
    if tex:
        text = re.sub(r"(?<!\\)%.*", "", text)
        text = re.sub(r"\\(cite|label)\{[^}]*\}", "", text).replace("~", " ")
        text = re.sub(r"\\tilde\s*\{?(\\omega|t)\}?", r"\1~", text)
        text = re.sub(r"\\(textit|text|bm|[, ])", "", text)
        text = re.sub(r"\\([a-zA-Z]+)", lambda m: WORDS.get(m[1], m[1]), text)
        text = re.sub(r"[{}$`]|''", "", text)
        text = re.sub(r"\|(\w+)\|", r"abs(\1)", text).replace(
            "abs(omega_xy0)", "omega_xy0"
        )
    return re.sub(r'[\s"]', "", text)


def test_what_stands_between_quotation_marks_is_the_papers():
    source = plain(EXCERPTS, tex=True)
    text = " ".join((PAPER / "claims.yaml").read_text().split())
    quotes = set(re.findall(r"“([^”{]*)”", text))
    assert len(quotes) > 50
    assert [quote for quote in sorted(quotes) if plain(quote) not in source] == []
    # A word that is not the paper's is noticed.
    assert plain("one could see K_p >> K_r") not in source


def cited_figures(text):
    """Return numbers of figures that a text cites: ``Fig. 7(a)``, ``Figs. 6 to 8``,
    ``fig7``.
    """
    spelt = re.findall(r"\bFigs?\. (\d+)(?:\(\w\))?(?:(?:,| to| and) (\d+))?", text)
    named = re.findall(r"\bfig(\d+)(?:_\w+)?\b", text)
    return {int(n) for pair in spelt for n in pair if n} | set(map(int, named))


def test_figures_have_their_printed_numbers():
    for number in range(3, 10):
        assert PARTS[f"fig{number}"]["title"].startswith(f"Fig. {number}: ")
    # A claim is measured by the figure in which the paper shows it.
    for claim in CLAIMS.values():
        cited = cited_figures(claim["where"])
        parts = claim.get("parts", ())
        assert not parts or not cited or cited & cited_figures(" ".join(parts))
    for place in ("rattlesweep", "docs", "configs"):
        for path in (ROOT / place).rglob("*"):
            if path.suffix in (".py", ".md", ".yaml", ".j2"):
                assert cited_figures(path.read_text()) <= set(range(3, 10)), path
