"""The table of claims: how a verdict is made, measures on made-up tables, the paper's own words."""

from __future__ import annotations

import ast
import math
import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from rattlesweep.paper.claim import (
    COLUMNS,
    TABLE,
    UNDECIDED,
    Claim,
    Count,
    claims,
    every,
    judge,
)
from rattlesweep.paper.report import closing_table
from rattlesweep.paper.report import plain as shown
from rattlesweep.paper.reproduce import PARTS

BY_ID = claims()
ROOT = Path(__file__).parents[2]


def judgement(*checks, few=False, leeway="", **numbers):
    """Judge a claim that was checked so."""
    claim = Claim(
        id="T1", where="", words="words", criteria=tuple(f"check {k}" for k in range(len(checks))),
        measure=lambda made: (checks, numbers), measured="measured", notes="End.", leeway=leeway,
    )  # fmt: skip
    return claim.judge({}, few=few)


# ----------------------------------------------------------------------------- the verdict


def test_a_verdict_is_made_of_checks_the_first_of_which_is_the_headline():
    cases = ((True, True), (True, False), (False, True))
    assert [judgement(*c)["verdict"] for c in cases] == ["agree", "partly", "disagree"]
    one = judgement(True, Count(2, 3), every([True, True]), value=math.nan)
    assert one["evidence"] == (
        "Checks, headline first: check 0: yes; check 1: no, 2 of 3; check 2: yes, 2 of 2. End."
    )
    assert (one["held"], one["checks"], one["headline"]) == (2, 3, "check 0")
    assert one["value"] is None
    assert set(one) == set(COLUMNS)
    # The claim stands beside its id.
    assert closing_table([one]) == "T1   partly (2 of 3): words\n     found: measured"


def test_few_samples_cannot_tell_what_lies_within_their_error():
    within, beyond = Count(8, 10, unsure=2), Count(8, 10, unsure=1)
    # With the paper's own number of samples a check that fails has failed.
    assert [judgement(True, c)["verdict"] for c in (within, beyond)] == ["partly"] * 2
    found = [judgement(True, c, few=True)["verdict"] for c in (within, beyond, True, False)]
    assert found == [UNDECIDED, "partly", "agree", "partly"]
    assert judgement(within, False, few=True)["verdict"] == UNDECIDED
    assert judgement(beyond, True, few=True)["verdict"] == "disagree"
    nothing = Claim(id="S8", where="", words="", criteria=("a",), measure=lambda made: None,
                    measured="")  # fmt: skip
    assert nothing.judge({})["verdict"] == UNDECIDED


def test_every_claim_is_one_row():
    listed = {"T1", "T2", "T3", "T4", "T5", "T6", "T7", "T8", "G1", "G2", "G3", "U1", "U2", "S1",
              "S2", "S3", "S4", "S5", "S6", "S7", "S8", "S9", "S9b", "L1", "L2", "L3", "L4",
              "C1"}  # fmt: skip
    assert set(BY_ID) == listed
    assert all(claim.words and claim.measured and claim.criteria for claim in BY_ID.values())
    assert {part for claim in BY_ID.values() for part in claim.parts} <= set(PARTS)
    assert judge({}, theory=False) == []


# ------------------------------------------------------------------------------ the sweeps


def points(ratio=1.0, scatter=0.01, error=0.01):
    """Return ideal points: on the line, times ``ratio``."""
    axes = np.meshgrid([0.1, 0.3, 1.0], [0.1, 0.2, 0.3, 0.4, 0.5], [0.001, 0.01, 0.1])
    k, n, w = (axis.ravel() for axis in axes)
    n_0 = np.hypot(n, w)
    line = 2 * np.arctanh(n / n_0) / (n_0 * k)
    return pd.DataFrame(
        {"K_p": k, "n_i": n, "omega_xy0": w, "runs": 9, "reversed": 9, "t_r_mean": ratio * line,
         "t_r_std": scatter * line, "t_r_low": (1 - error) * ratio * line,
         "t_r_high": (1 + error) * ratio * line, "t_rgh_line": line}
    )  # fmt: skip


def u1(table, **options):
    return BY_ID["U1"].judge({"fig6": {"times": table}}, **options)


def test_verdicts_follow_the_measurement():
    assert u1(points())["verdict"] == "agree"
    off = u1(points(ratio=2.0))
    # The slopes and the scatter are as they should be; of the headline nothing is left.
    assert (off["verdict"], off["held"], off["checks"]) == ("disagree", 2, 3)
    assert off["value"] == pytest.approx(2.0)
    assert u1(points(scatter=0.9))["verdict"] == "partly"
    assert u1(points(ratio=1.3, error=0.1), few=True)["verdict"] == UNDECIDED
    assert u1(points(ratio=1.3, error=0.1))["verdict"] == "disagree"


# -------------------------------------------------------------------------- the paper's words

EXCERPTS = Path(__file__).parent / "paper_excerpts.tex"
# Labels of the numbered equations in their order; a dash is one without a label.
LABELS = """
em-1 em-2 no-slip def-z - - - def-xy - diff-u diff-omega - - def-abg - lin-u lin-omg1 -
lin-omg2 - lin-omg3 lin-omg4 def-omgpr def-omega_pr omega_pr - - omega_p0 omega_r0 ave-torque
def-kpr ave-ene kp-1 kp-2 kr-1 kr-2 k-rat k-diff Kp Kr - - omg_pr-approx-omgpr0 sign-typ-k - -
diff-ne-1 diff-ne-2 diff-ne-3 - casimir - diff-n - gh-solution-p trgh-p gh-solution-m trgh-m
ratomg - - - - - - - - sim-ic-1 sim-ic-2 sim-ic-3 - def-n0 def-nc1 case-instab1 toki-prs
"""
NUMBERED = LABELS.split()
WORDS = {"lesssim": "<~", "gtrsim": ">~", "approx": "~", "ll": "<<", "gg": ">>", "le": "<=",
         "circ": "deg"}  # fmt: skip


def uncommented(tex):
    return re.sub(r"(?<!\\)%.*", "", tex)


def plain(text, *, tex=False):
    """Return text without spaces, its mathematics spelt as in the claims."""
    if tex:
        text = re.sub(r"\\(cite|label)\{[^}]*\}", "", uncommented(text)).replace("~", " ")
        text = re.sub(r"\\tilde\s*\{?(\\omega|t)\}?", r"\1~", text)
        text = re.sub(r"\\(textit|text|bm|[, ])", "", text)
        text = re.sub(r"\\([a-zA-Z]+)", lambda m: WORDS.get(m[1], m[1]), text)
        text = re.sub(r"[{}$`]|''", "", text)
        text = re.sub(r"\|(\w+)\|", r"abs(\1)", text).replace("abs(omega_xy0)", "omega_xy0")
    return re.sub(r'[\s"]', "", text)


def texts():
    """Yield all texts of the room of the paper, as far as they are written out in its sources."""
    for path in (TABLE, TABLE.with_name("parts.yaml")):
        yield " ".join(path.read_text().split())
    for path in sorted(TABLE.parent.glob("*.py")):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Constant) and isinstance(node.value, str):
                yield node.value


def figures_of(tex):
    """Return labels of the figures in their order: each environment has a caption and a number."""
    return re.findall(r"\\begin\{figure\*?\}.*?\\label\{fig:([^}]*)\}", tex, re.DOTALL)


def test_what_stands_between_quotation_marks_is_the_papers():
    source = plain(EXCERPTS.read_text(), tex=True)
    quotes = {q for text in texts() for q in re.findall(r"“([^”{]*)”", text)}
    assert len(quotes) > 50
    assert [quote for quote in sorted(quotes) if plain(quote) not in source] == []
    # A word that is not the paper's is noticed.
    assert plain("one could see K_p >> K_r") not in source


def test_equations_have_their_printed_numbers():
    cited = {pair for text in texts() for pair in re.findall(r"\((\d+)\) \[([\w-]+)\]", text)}
    assert len(cited) > 8
    assert [pair for pair in cited if NUMBERED[int(pair[0]) - 1] != pair[1]] == []
    # No label goes without its number, and none is shown to a reader of the pages.
    labels = "|".join(sorted(set(NUMBERED) - {"-", "Kp", "Kr"}, key=len, reverse=True))
    bare = re.compile(rf"Eqs?\. (?:[\w-]+, )*(?:{labels})\b")
    assert [text for text in texts() if bare.search(text)] == []
    assert shown("Eq. (38) [k-diff] in [0.1, 0.2]") == "Eq. (38) in [0.1, 0.2]"


# What the caption of a figure is about, in the paper and here.
ABOUT = {"omega-dist": "frequencies", "k-dist": "asymmetric torque coefficients",
         "gh-t-n": "spin", "kptr": "unsteady direction", "krtr": "fractions of",
         "krtr-2": "steady direction", "periodic": "three"}  # fmt: skip


def cited_figures(text):
    """Return numbers of figures that a text cites: ``Fig. 7(a)``, ``Figs. 6 to 8``, ``fig7``."""
    spelt = re.findall(r"\bFigs?\. (\d+)(?:\(\w\))?(?:(?:,| to| and) (\d+))?", text)
    named = re.findall(r"\bfig(\d+)(?:_\w+)?\b", text)
    return {int(n) for pair in spelt for n in pair if n} | set(map(int, named))


def test_figures_have_their_printed_numbers():
    tex = EXCERPTS.read_text()
    labels = figures_of(tex)
    assert len(labels) == 9
    captions = dict(zip(labels, re.split(r"\\label\{fig:[^}]*\}", tex)[1:], strict=True))
    for number, label in enumerate(labels, start=1):
        if number < 3:
            continue
        part = PARTS[f"fig{number}"]
        assert part.title.startswith(f"Fig. {number}: ")
        assert ABOUT[label] in f"{part.title} {part.caption}".lower()
        assert ABOUT[label] in " ".join(captions[label].split("\n\n")[0].split()).lower()
    # A claim is measured by the figure in which the paper shows it.
    for claim in BY_ID.values():
        cited = cited_figures(claim.where)
        assert not claim.parts or not cited or cited & cited_figures(" ".join(claim.parts))
    for place in ("rattlesweep", "docs", "configs"):
        for path in (ROOT / place).rglob("*"):
            if path.suffix in (".py", ".md", ".yaml", ".j2"):
                assert cited_figures(path.read_text()) <= set(range(3, 10)), path
