"""Figs. 3 and 4 of the paper and its claims about theory, at reduced size."""

from types import SimpleNamespace

import numpy as np
import pytest
import theory_mp

from rattlesweep.paper.claims import formulas
from rattlesweep.paper.claims.claim import claims, judge
from rattlesweep.paper.figures import fig3, fig4
from rattlesweep.paper.parts import PARTS
from rattlesweep.physics import full, theory
from rattlesweep.physics.body import Rattleback
from rattlesweep.sweeps.config.schema import SdRanges


def ignore(share):
    assert 0 <= share <= 1 + 1e-12


@pytest.fixture(scope="module")
def fig3_tables():
    return fig3.data(40_000, SdRanges(), ignore)


@pytest.fixture(scope="module")
def fig4_tables():
    return fig4.data(20_000, 1_500_000, SdRanges(), 2, ignore)


# --- bodies by their coefficients ---------------------------------------------------------------


def test_bodies_are_counted_by_their_coefficients():
    size = 250_000
    alpha, beta, _, th, phi, xi = fig3.drawn_bodies(0, size, SdRanges(), 7)
    found = theory.modes(alpha, beta, th, phi, xi)
    wanted = np.histogram2d(found.K_p, found.K_r, bins=[fig4.edges("K_p"), fig4.edges("K_r")])[0]
    shares = []
    for threads in (1, 2, 3):
        counts, least, below = fig4.count_bodies(size, SdRanges(), threads, shares.append, seed=7)
        # A coefficient on an edge may fall on either side by its last bit.
        assert np.abs(counts - wanted).sum() <= 4
        ratio = found.omega_p / found.omega_r
        assert least == pytest.approx(ratio.min(), rel=1e-14)
        assert below == np.count_nonzero(ratio < fig3.BOUND)
    assert shares[-1] == 1
    other, _, _ = fig4.count_bodies(size, SdRanges(), 2, ignore, seed=4)
    assert not np.array_equal(other, counts)


def test_bodies_outside_the_bins_are_counted_as_such(monkeypatch):
    monkeypatch.setattr(fig4, "ENDS", {"K_p": (0.2, 0.5), "K_r": (0.01, 0.02)})
    row = fig4.data(100, 50_000, SdRanges(), 2, ignore)["summary"].to_dict("records")[0]
    assert 10_000 < row["outside"] < 49_000


def test_a_stop_ends_the_counting():
    def stop(share):
        raise KeyboardInterrupt

    for count in (
        lambda: fig4.count_bodies(10**9, SdRanges(), 2, stop),
        lambda: fig3.data(1000, SdRanges(), stop),
    ):
        with pytest.raises(KeyboardInterrupt):
            count()


def test_fig3_tables(fig3_tables):
    data = fig3_tables["cumulative"]
    assert list(data["probability"].iloc[[0, -1]]) == [0, 1]
    assert (data.diff().dropna() >= 0).all().all()
    # Against the defining matrix, of the same formulas.
    alpha, beta, _, th, phi, xi = fig3.drawn_bodies(0, 40_000, SdRanges())
    ratio = np.sqrt(formulas.by_definition((alpha, beta, alpha, th, phi, xi))["ratio"])
    assert data["ratio"].iloc[[0, -1]].tolist() == pytest.approx([ratio.min(), ratio.max()])
    middle = data[data["probability"] == 0.5].iloc[0]
    for name, values in (("ratio", ratio), ("omega_p0", np.sqrt((1 / phi - 1) / alpha)),
                         ("omega_r0", np.sqrt((1 / th - 1) / beta))):  # fmt: skip
        assert middle[name] == pytest.approx(np.median(values), rel=1e-3)


def test_fig4_tables(fig4_tables):
    row = fig4_tables["summary"].to_dict("records")[0]
    data = fig4_tables["density"]
    assert data["count"].sum() + row["outside"] == 1_500_000
    assert data["relative_frequency"].sum() == pytest.approx(1, abs=1e-3)
    assert (data["count"] > 0).all()
    assert fig4.counts_of(fig4_tables).sum() == data["count"].sum()
    # A body's coefficients lie in its bin: mean of K_p from the bins and from the quantiles.
    middle = (data["K_p_low"] + data["K_p_high"]) / 2
    mean = (middle * data["count"]).sum() / data["count"].sum()
    assert mean == pytest.approx(np.mean(fig4_tables["cumulative"]["K_p"].to_numpy()), rel=0.05)


@pytest.mark.parametrize("name", ["fig3", "fig4"])
def test_nothing_of_a_picture_hangs_over_the_edge(request, name):
    tables = request.getfixturevalue(f"{name}_tables")
    drawing = PARTS[name].draw(tables)
    drawing.canvas.draw()
    width, height = drawing.canvas.get_width_height()
    for axes in drawing.axes:
        box = axes.get_tightbbox()
        assert min(box.x0, box.y0) >= -1
        assert box.x1 <= width + 1
        assert box.y1 <= height + 1


# --- the claims (of formulas that tests/physics/test_theory.py checks at 50 digits) --------------


def claim(name, **tables):
    """Judge one claim, those of theory alone by a few formulas."""
    row = claims()[name]
    return row.judge(tables, **({"samples": 50} if not row.parts and name != "T1" else {}))


def test_claims_and_what_they_need(fig3_tables, fig4_tables):
    figures = {"fig3": fig3_tables, "fig4": fig4_tables}
    rows = {c["id"]: c for c in judge(figures, theory=True)}
    verdicts = {name: row["verdict"] for name, row in rows.items()}
    assert verdicts == {
        "T1": "agree", "T2": "partly", "T3": "agree", "T4": "partly", "T5": "agree",
        "T6": "agree", "T7": "agree", "T8": "agree", "S9": "partly",
    }  # fmt: skip
    assert [c["id"] for c in judge(figures, theory=False)] == ["T4", "T5"]
    for row in rows.values():
        assert row["evidence"].startswith(f"Checks, headline first: {row['headline']}: ")
        assert (row["low"] or 0) <= row["value"]
        assert row["high"] is None or row["value"] <= row["high"]


def test_t1_is_within_the_rounding_of_table_i():
    found = formulas.gh_numbers(Rattleback.gh())
    wrong = zip(formulas.PRINTED, formulas.as_printed(found), strict=True)
    assert [name for name, printed in wrong if not printed] == ["K_r"]
    exact = theory_mp.reference(13.04, 1.522, 12.28, 0.6429, 0.036, -0.03, 0.1, 0.01)
    assert round(float(exact["K_r"]), 4) == 0.0967
    row = claim("T1")
    assert row["low"] < 0.0967 < row["value"] < row["high"]


def test_t1_would_not_agree_beyond_the_rounding(monkeypatch):
    monkeypatch.setitem(formulas.PRINTED, "K_r", (0.0961, 4))
    assert claim("T1")["verdict"] == "disagree"


def test_extrapolation_is_exact_for_quadratics():
    x = 2.0 ** -np.arange(3, 8)
    assert formulas.extrapolated(5 + 3 * x - 7 * x**2) == pytest.approx(5, rel=1e-14)
    # A sequence with another limit is told apart.
    assert abs(formulas.extrapolated(5.001 + x) - 5) > 5e-4


def test_ellipsoids_by_integration():
    rng = np.random.default_rng(3)
    points = rng.uniform(-1, 1, (400_000, 3))
    inside = points[np.sum(points**2, axis=1) < 1]
    for kind, body in (("whole", inside), ("half", inside[inside[:, 2] > 0])):
        x, y, z = (body * [1.7, 3.0, 1.0]).T
        z = z - z.mean()
        height = 1 - formulas.CENTRE[kind]
        found = formulas.ellipsoid(kind, np.array(9.0), np.array(2.89))
        assert found["alpha"] == pytest.approx(np.mean(y**2 + z**2) / height**2 + 1, rel=0.01)
        assert found["beta"] == pytest.approx(np.mean(x**2 + z**2) / height**2 + 1, rel=0.01)
        b2, c2 = formulas.shapes(kind, 200)
        assert np.all(b2 > c2)
        assert np.all(formulas.ellipsoid(kind, b2, c2)["theta"] < 1)


def test_least_ratio_of_the_frequencies():
    ranges = SdRanges()
    bound = fig3.ratio_bound(ranges)
    assert bound == pytest.approx(np.sqrt((0.05 * 15 + 1) / (0.95 * 15 + 1) * 9 * 1.5), rel=1e-12)
    # No body is below, and some come close.
    rng = np.random.default_rng(2)
    for squeeze in (1.0, 1e-3):
        share = squeeze * rng.uniform(size=(5, 20_000))
        gamma, f_sd, th, phi, xi = (
            15 - 10 * share[0], 0.05 + 0.1 * share[1], 0.6 + 0.35 * share[2],
            0.1 - 0.09 * share[3], -np.radians(6 * share[4]),
        )  # fmt: skip
        alpha, beta = (1 - f_sd) * gamma + 1, f_sd * gamma + 1
        found = theory.modes(alpha, beta, th, phi, xi)
        least = (found.omega_p / found.omega_r).min()
        assert least > bound
    assert least < 1.001 * bound
    # With curvatures so close pitch and roll change places.
    assert fig3.ratio_bound(SdRanges(theta=[0.15, 0.2], phi=[0.05, 0.14])) == 1


DISAGREE = {"f_sd": [0.3, 0.45], "theta": [0.4, 0.5], "phi": [0.2, 0.39],
            "minus_xi_deg": [20.0, 30.0]}  # fmt: skip


@pytest.mark.parametrize(
    ("ranges", "verdict"),
    [({"theta": [0.75, 0.95]}, "agree"), ({}, "partly"), (DISAGREE, "disagree")],
)
def test_t4_follows_the_measurement(ranges, verdict):
    tables = fig3.data(5000, SdRanges(**ranges), ignore)
    assert claim("T4", fig3=tables)["verdict"] == verdict


def test_t5_follows_the_measurement(fig4_tables):
    density = fig4_tables["density"]
    scaled = density.assign(relative_frequency=1e3 * density["relative_frequency"])
    assert claim("T5", fig4=fig4_tables | {"density": scaled})["verdict"] == "partly"
    # The two parts of the figure must be of the same formulas.
    others = SdRanges(theta=[0.6, 0.62], phi=[0.09, 0.1])
    other = fig4.data(20_000, 100, others, 1, ignore)["cumulative"]
    assert claim("T5", fig4=fig4_tables | {"cumulative": other})["verdict"] == "disagree"


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
