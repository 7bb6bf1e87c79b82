"""Figs. 3 and 4 of the paper and its claims about theory, at reduced size."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import theory_mp

from rattlesweep.paper import fig3_4, formulas
from rattlesweep.paper.claim import judge, judge_claim, read_table
from rattlesweep.paper.workspace import QUICK, Workspace
from rattlesweep.physics import full, theory
from rattlesweep.sweeps.config.schema import SdRanges

SIZES = replace(QUICK, fig3_bodies=40_000, fig4_bodies=20_000, fig4_density=1_500_000)


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    ws = Workspace(tmp_path_factory.mktemp("paper"), SIZES, threads=2)
    return {"fig3": fig3_4.frequencies(ws), "fig4": fig3_4.coefficients(ws)}


@pytest.fixture(autouse=True)
def few(monkeypatch):
    monkeypatch.setattr(formulas, "SAMPLES", 50)


def claim(name, **tables):
    return judge_claim(read_table("claims")[name], tables, few=False)


def test_bodies_are_counted_by_their_coefficients():
    size = 250_000
    alpha, beta, _, th, phi, xi = fig3_4.drawn_bodies(0, size)
    found = theory.modes(alpha, beta, th, phi, xi)
    bins = [*fig3_4.EDGES.values()]
    wanted = np.histogram2d(found.K_p, found.K_r, bins=bins)[0]
    few = np.count_nonzero(found.omega_p / found.omega_r < fig3_4.BOUND)
    for threads in (1, 3):
        counts, below = fig3_4.count_bodies(size, threads)
        # A coefficient on an edge may fall on either side by its last bit.
        assert np.abs(counts - wanted).sum() <= 4
        assert below == few


def test_distributions_are_those_of_the_defining_matrix(made):
    data = made["fig3"]["cumulative"]
    assert list(data["probability"].iloc[[0, -1]]) == [0, 1]
    assert (data.diff().dropna() >= 0).all().all()
    alpha, beta, _, th, phi, xi = fig3_4.drawn_bodies(0, SIZES.fig3_bodies)
    ratio = np.sqrt(formulas.by_definition((alpha, beta, alpha, th, phi, xi))["ratio"])
    assert data["ratio"].iloc[[0, -1]].tolist() == pytest.approx([ratio.min(), ratio.max()])
    middle = data[data["probability"] == 0.5].iloc[0]
    for name, values in (("ratio", ratio), ("omega_p0", np.sqrt((1 / phi - 1) / alpha)),
                         ("omega_r0", np.sqrt((1 / th - 1) / beta))):  # fmt: skip
        assert middle[name] == pytest.approx(np.median(values), rel=1e-3)


# --- the claims (of formulas that tests/physics/test_theory.py checks at 50 digits) --------------


def test_claims_and_what_they_need(made):
    rows = {c["id"]: c for c in judge(made, theory=True)}
    assert {name: row["verdict"] for name, row in rows.items()} == {
        "T1": "agree", "T2": "partly", "T3": "agree", "T4": "partly", "T5": "agree",
        "T6": "agree", "T7": "agree", "T8": "agree", "S9": "partly",
    }  # fmt: skip
    assert [c["id"] for c in judge(made, theory=False)] == ["T4", "T5"]
    for row in rows.values():
        assert row["evidence"].startswith(f"Checks, headline first: {row['headline']}: ")
        assert (row["low"] or 0) <= row["value"]
        assert row["high"] is None or row["value"] <= row["high"]


def test_t1_is_within_the_rounding_of_table_i(monkeypatch):
    printed = formulas.as_printed(formulas.gh_numbers())
    assert [name for name, same in printed.items() if not same] == ["K_r"]
    exact = theory_mp.reference(13.04, 1.522, 12.28, 0.6429, 0.036, -0.03, 0.1, 0.01)
    assert round(float(exact["K_r"]), 4) == 0.0967
    row = claim("T1")
    assert row["low"] < 0.0967 < row["value"] < row["high"]
    monkeypatch.setitem(formulas.PRINTED, "K_r", (0.0961, 4))
    assert claim("T1")["verdict"] == "disagree"


def test_no_body_is_below_the_least_ratio_of_the_frequencies():
    bound = fig3_4.ratio_bound()
    assert bound == pytest.approx(np.sqrt((0.05 * 15 + 1) / (0.95 * 15 + 1) * 9 * 1.5), rel=1e-12)
    ends = np.array(SdRanges().ends())
    corner = np.array([15, 0.05, 0.6, 0.1, 0.0])[:, None]
    shares = np.random.default_rng(2).uniform(size=(5, 20_000))
    for squeeze in (1.0, 1e-3):
        inward = np.where(corner == ends[:, :1], 1, -1) * squeeze * np.diff(ends)
        gamma, f_sd, th, phi, xi = corner + inward * shares
        found = theory.modes((1 - f_sd) * gamma + 1, f_sd * gamma + 1, th, phi, -np.radians(xi))
        least = (found.omega_p / found.omega_r).min()
        assert least > bound
    assert least < 1.001 * bound


def changed(function, **factors):
    """The function, one of whose results is a little off."""

    def off(*args, **kwargs):
        found = function(*args, **kwargs)
        values = dict(found if isinstance(found, dict) else vars(found))
        values |= {name: factor * values[name] for name, factor in factors.items()}
        return values if isinstance(found, dict) else SimpleNamespace(**values)

    return off


@pytest.mark.parametrize(
    ("module", "name", "wrong", "names"),
    [
        (theory, "modes", changed(theory.modes, K_p=1 + 1e-7), ["T3", "T7"]),
        (theory, "bondi_threshold", lambda *a, f=theory.bondi_threshold: 1.0001 * f(*a), ["S9"]),
        (full.rhs, "py_func", lambda *_: (0.0, 0.0, 1e-12, 0.0, 0.0), ["S9"]),
        (formulas, "ellipsoid", changed(formulas.ellipsoid, alpha=1.1), ["T6"]),
        (formulas, "by_definition", changed(formulas.by_definition, K_r=1.001), ["T2"]),
    ],
)
def test_wrong_theory_is_found_out(monkeypatch, module, name, wrong, names):
    """Each claim disagrees with formulas that are a little wrong."""
    monkeypatch.setattr(module, name, wrong)
    assert [claim(each)["verdict"] for each in names] == ["disagree"] * len(names)
