"""The table of claims: how a verdict is made, the measures of the sweeps, the paper's own words."""

from __future__ import annotations

import ast
import math
import os
import re
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pytest

from rattlesweep.paper import run
from rattlesweep.paper.claims import sweeps as measures
from rattlesweep.paper.claims.claim import CLAIMS, TABLE, Claim, Count, claims, every, judge
from rattlesweep.paper.columns import table
from rattlesweep.paper.figures import fig5
from rattlesweep.paper.report import closing_table

BY_ID = claims()


def judgement(*checks, **numbers):
    """Of a claim that was checked so."""
    claim = Claim(
        id="T1", where="", words="", criteria=tuple(f"check {k}" for k in range(len(checks))),
        measure=lambda tables: (checks, numbers), measured="measured", notes="End.",
    )  # fmt: skip
    return claim.judge({})


# ----------------------------------------------------------------------------- the verdict


def test_a_verdict_is_made_of_checks_the_first_of_which_is_the_headline():
    cases = ((True, True), (True, False), (False, True))
    assert [judgement(*c)["verdict"] for c in cases] == ["agree", "partly", "disagree"]
    one = judgement(True, Count(2, 3), every([True, True]))
    assert one["evidence"] == (
        "Checks, headline first: check 0: yes; check 1: no, 2 of 3; check 2: yes, 2 of 2. End."
    )
    assert re.split("  +", closing_table([one])) == ["T1", "partly", "2 of 3", "measured"]
    row = table([one], CLAIMS).to_pylist()[0]
    assert (row["held"], row["checks"], row["headline"]) == (2, 3, "check 0")


def test_words_of_the_paper_leave_room_for_one_in_ten():
    def verdict(leeway, head):
        claim = Claim(
            id="U1", where="", words="", criteria=("all",), measure=lambda tables: ([head], {}),
            measured="", leeway=leeway,
        )  # fmt: skip
        return claim.judge({})["verdict"]

    assert verdict("“almost”", Count(9, 10)) == "partly"
    assert verdict("", Count(9, 10)) == verdict("“almost”", Count(8, 10)) == "disagree"
    assert verdict("“almost”", False) == verdict("“almost”", Count(0, 0)) == "disagree"
    assert verdict("“almost”", Count(10, 10)) == "agree"


def test_of_nothing_not_all_is_true():
    assert not every([])
    assert every([True]) + Count(0, 1) == Count(1, 2)


def test_numbers_that_are_none_are_null_in_the_table():
    found = judgement(True, False, value=math.nan, low=-math.inf)
    row = table([found], CLAIMS).to_pylist()[0]
    assert (row["value"], row["low"], row["high"]) == (None, None, None)


def test_every_claim_is_one_row():
    assert len(BY_ID) >= 24
    assert all(claim.words and claim.measured and claim.criteria for claim in BY_ID.values())
    assert judge({}, theory=False) == []


# ------------------------------------------------------------------------------ the sweeps


def points(coefficient="K_p", sign=1, ratio=1.0, scatter=0.01):
    """Ideal points: on the line, times ``ratio``."""
    rows = []
    for k in (0.1, 0.3, 1.0):
        for n in (0.1, 0.2, 0.3, 0.4, 0.5):
            for w in (0.001, 0.01, 0.1):
                line = fig5.gh_line(k, n, math.hypot(n, w))
                rows.append({coefficient: k, "n_i": sign * n, "omega_xy0": w, "runs": 9,
                             "reversed": 9, "t_r_mean": ratio * line, "t_r_std": scatter * line,
                             "t_r_low": 0.99 * ratio * line, "t_r_high": 1.01 * ratio * line,
                             "t_rgh_line": line})  # fmt: skip
    return pa.Table.from_pandas(pd.DataFrame(rows))


def u1(table):
    return BY_ID["U1"].judge({"fig5": {"times": table}})


def test_verdicts_follow_the_measurement():
    assert u1(points())["verdict"] == "agree"
    off = u1(points(ratio=2.0))
    # The slopes and the scatter are as they should be; of the headline nothing is left.
    assert (off["verdict"], off["held"], off["checks"]) == ("disagree", 2, 3)
    assert off["value"] == pytest.approx(2.0)
    assert u1(points(scatter=0.9))["verdict"] == "partly"


def test_points_without_a_run_settle_nothing():
    frame = points().to_pandas()
    frame.loc[3, "runs"] = 0
    assert u1(pa.Table.from_pandas(frame)) is None


def fractions(wrong=0):
    """Types as Bondi's threshold has them, of which a few runs are on the wrong side."""
    rows = []
    for k, n in ((k, n) for k in (0.01, 0.03, 0.1) for n in (0.1, 0.2, 0.3, 0.4, 0.5)):
        for w in (0.001, 0.01, 0.1):
            steady = max(0, round(100 * (n - 0.2) * (0.11 - k)))
            counts = {"SS": steady, "SW": 0, "unclassified": 0, "R": 100 - steady}
            rows.append({"K_r": k, "n_i": -n, "omega_xy0": w, "runs": 100, "bondi": steady,
                         "ss_only": 0, "bondi_only": 0, **counts,
                         **{f"fraction_{name}": count / 100 for name, count in counts.items()},
                         "low_SS": 0.0, "high_SS": 1.0})  # fmt: skip
    rows[0]["ss_only"] = wrong
    return pa.Table.from_pylist(rows)


def test_one_body_on_the_wrong_side_of_the_threshold_changes_s3():
    s3 = [BY_ID["S3"].judge({"fig6": {"fractions": fractions(wrong)}}) for wrong in (0, 1)]
    assert [found["verdict"] for found in s3] == ["agree", "disagree"]
    assert s3[0]["low"] == 0 < s3[1]["low"]


def test_the_frequency_of_a_swing_is_found():
    t = np.linspace(0, 300, 6001)
    slow = 0.5 * np.tanh((150 - t) / 30)
    found = measures.swing_frequency(t, slow + 0.05 * np.sin(2.9 * t))
    assert found == pytest.approx(2.9, abs=0.02)


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
    """Text without spaces, its mathematics spelt as in the claims."""
    if tex:
        text = re.sub(r"\\(cite|label)\{[^}]*\}", "", uncommented(text)).replace("~", " ")
        text = re.sub(r"\\tilde\s*\{?(\\omega|t)\}?", r"\1~", text)
        text = re.sub(r"\\(textit|text|bm|[, ])", "", text)
        text = re.sub(r"\\([a-zA-Z]+)", lambda m: WORDS.get(m[1], m[1]), text)
        text = re.sub(r"[{}$`]|''", "", text)
        text = re.sub(r"\|(\w+)\|", r"abs(\1)", text).replace("abs(omega_xy0)", "omega_xy0")
    return re.sub(r'[\s"]', "", text)


def texts():
    """All texts of the room of the paper, as far as they are written out in its sources."""
    yield " ".join(TABLE.read_text().split())
    for path in sorted(Path(run.__file__).parent.rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Constant) and isinstance(node.value, str):
                yield node.value


def numbers_of(tex):
    """Labels of numbered equations: amsmath numbers each row of align that does not say notag."""
    found = []
    for kind, body in re.findall(
        r"\\begin\{(equation|align|multline)\}(.*?)\\end\{\1\}", uncommented(tex), re.DOTALL
    ):
        flat = re.sub(r"\\begin\{pmatrix\}.*?\\end\{pmatrix\}", "", body, flags=re.DOTALL)
        for row in flat.split(r"\\") if kind == "align" else [body]:
            if r"\notag" not in row:
                label = re.search(r"\\label\{\w+:([^}]*)\}", row)
                found.append(label[1] if label else "-")
    return found


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
    # No label goes without its number.
    labels = "|".join(sorted(set(NUMBERED) - {"-", "Kp", "Kr"}, key=len, reverse=True))
    bare = re.compile(rf"Eqs?\. (?:[\w-]+, )*(?:{labels})\b")
    assert [text for text in texts() if bare.search(text)] == []


@pytest.mark.skipif("RATTLESWEEP_PAPER" not in os.environ, reason="needs the paper's source")
def test_excerpts_and_numbers_are_those_of_the_source():
    source = Path(os.environ["RATTLESWEEP_PAPER"]).read_text()
    for excerpt in EXCERPTS.read_text().split("\n\n"):
        assert plain(excerpt, tex=True) in plain(source, tex=True)
    assert numbers_of(source) == NUMBERED
