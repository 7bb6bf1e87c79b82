"""Figs. 2 and 3 of the paper and its claims about theory, at reduced size."""

from types import SimpleNamespace

import numpy as np
import pytest
import theory_mp
from mpmath import mp
from telling import quiet

from rattlesweep.paper.claims import bodies
from rattlesweep.paper.claims import theory as measures
from rattlesweep.paper.claims.claim import claims, judge
from rattlesweep.paper.figures import fig2, fig3
from rattlesweep.paper.registry import FIGURES
from rattlesweep.physics import full, theory
from rattlesweep.physics.body import Rattleback
from rattlesweep.sweeps.config.bodies import SdRanges


@pytest.fixture(scope="module")
def fig2_tables():
    return fig2.distributions(40_000, SdRanges(), quiet)


@pytest.fixture(scope="module")
def fig3_tables():
    return fig3.distributions(20_000, 1_500_000, SdRanges(), 2, quiet)


# --- bodies by their coefficients ---------------------------------------------------------------


def test_bodies_are_counted_by_their_coefficients():
    size = 250_000
    alpha, beta, _, th, phi, xi = fig2.drawn_bodies(0, size, SdRanges(), 7)
    found = theory.modes(alpha, beta, th, phi, xi)
    wanted = np.histogram2d(found.K_p, found.K_r, bins=[fig3.edges("K_p"), fig3.edges("K_r")])[0]
    shares = []
    for threads in (1, 2, 3):
        counts, least, below = fig3.count_bodies(
            size, SdRanges(), threads, lambda s, w: shares.append(s), seed=7
        )
        # A coefficient on an edge may fall on either side by its last bit.
        assert np.abs(counts - wanted).sum() <= 4
        ratio = found.omega_p / found.omega_r
        assert least == pytest.approx(ratio.min(), rel=1e-14)
        assert below == np.count_nonzero(ratio < fig2.BOUND)
    assert shares[-1] == 1
    other, _, _ = fig3.count_bodies(size, SdRanges(), 2, quiet, seed=4)
    assert not np.array_equal(other, counts)


def test_bodies_outside_the_bins_are_counted_as_such(monkeypatch):
    monkeypatch.setattr(fig3, "ENDS", {"K_p": (0.2, 0.5), "K_r": (0.01, 0.02)})
    row = fig3.distributions(100, 50_000, SdRanges(), 2, quiet)["summary"].to_pylist()[0]
    assert 10_000 < row["outside"] < 49_000


def test_a_stop_ends_the_counting():
    def stop(share, words):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        fig3.count_bodies(10**9, SdRanges(), 2, stop)
    with pytest.raises(KeyboardInterrupt):
        fig2.distributions(1000, SdRanges(), stop)


def test_fig2_tables(fig2_tables):
    data = fig2_tables["cumulative"].to_pandas()
    assert list(data["probability"].iloc[[0, -1]]) == [0, 1]
    assert (data.diff().dropna() >= 0).all().all()
    # Against the defining matrix, of the same bodies.
    alpha, beta, _, th, phi, xi = fig2.drawn_bodies(0, 40_000, SdRanges())
    found = measures.by_definition((alpha, beta, alpha, th, phi, xi))
    middle, ratio = data[data["probability"] == 0.5].iloc[0], np.sqrt(found["ratio"])
    assert middle["ratio"] == pytest.approx(np.median(ratio), rel=1e-3)
    assert data["ratio"].iloc[[0, -1]].tolist() == pytest.approx([ratio.min(), ratio.max()])
    assert middle["omega_p0"] == pytest.approx(np.median(np.sqrt((1 / phi - 1) / alpha)), rel=1e-3)
    assert middle["omega_r0"] == pytest.approx(np.median(np.sqrt((1 / th - 1) / beta)), rel=1e-3)


def test_fig3_tables(fig3_tables):
    row = fig3_tables["summary"].to_pylist()[0]
    data = fig3_tables["density"].to_pandas()
    assert data["count"].sum() + row["outside"] == 1_500_000
    assert data["relative_frequency"].sum() == pytest.approx(1, abs=1e-3)
    assert (data["count"] > 0).all()
    assert fig3.counts_of(fig3_tables).sum() == data["count"].sum()
    # A body's coefficients lie in its bin: mean of K_p from the bins and from the quantiles.
    middle = (data["K_p_low"] + data["K_p_high"]) / 2
    mean = (middle * data["count"]).sum() / data["count"].sum()
    assert mean == pytest.approx(np.mean(fig3_tables["cumulative"]["K_p"].to_numpy()), rel=0.05)


@pytest.mark.parametrize(("name", "figure"), [("fig2", FIGURES["fig2"]), ("fig3", FIGURES["fig3"])])
def test_nothing_of_a_picture_hangs_over_the_edge(request, name, figure):
    tables = request.getfixturevalue(f"{name}_tables")
    assert all(b"unit" in field.metadata for table in tables.values() for field in table.schema)
    drawing = figure.draw(tables)
    drawing.canvas.draw()
    width, height = drawing.canvas.get_width_height()
    for axes in drawing.axes:
        box = axes.get_tightbbox()
        assert min(box.x0, box.y0) >= -1
        assert box.x1 <= width + 1
        assert box.y1 <= height + 1


# --- the claims ---------------------------------------------------------------------------------


def claim(name, **tables):
    """Judge one claim, those of theory alone by a few bodies."""
    row = claims()[name]
    return row.judge(tables, **({"samples": 50} if not row.figures and name != "T1" else {}))


def test_claims_and_what_they_need(fig2_tables, fig3_tables):
    figures = {"fig2": fig2_tables, "fig3": fig3_tables}
    rows = {c["id"]: c for c in judge(figures, theory=True)}
    verdicts = {name: row["verdict"] for name, row in rows.items()}
    assert verdicts == {
        "T1": "disagree", "T2": "partly", "T3": "agree", "T4": "partly", "T5": "agree",
        "T6": "agree", "T7": "agree", "S9": "partly",
    }  # fmt: skip
    assert [c["id"] for c in judge(figures, theory=False)] == ["T4", "T5"]
    for row in rows.values():
        assert row["evidence"].startswith(f"Checks, headline first: {row['headline']}: ")
        assert (row["low"] or 0) <= row["value"]
        assert row["high"] is None or row["value"] <= row["high"]


def test_t1_is_off_in_one_digit_that_the_skew_angle_explains():
    found = measures.gh_numbers(Rattleback.gh())
    wrong = zip(measures.PRINTED, measures.as_printed(found), strict=True)
    assert [name for name, printed in wrong if not printed] == ["K_r"]
    exact = theory_mp.reference(13.04, 1.522, 12.28, 0.6429, 0.036, -0.03, 0.1, 0.01)
    assert round(float(exact["K_r"]), 4) == 0.0967
    assert "yes, 6 of 6" in claim("T1")["evidence"]


def test_definition_of_the_coefficients_against_fifty_digits():
    body = tuple(
        np.concatenate(p) for p in zip(bodies.sd_bodies(15), bodies.wide_bodies(15), strict=True)
    )
    got = measures.by_definition(body)
    for i, row in enumerate(np.stack(body, -1).tolist()):
        wanted = theory_mp.reference(*row, 0.1, 0.01)
        assert got["K_p"][i] == pytest.approx(float(wanted["K_p"]), rel=1e-9)
        assert got["K_r"][i] == pytest.approx(float(wanted["K_r"]), abs=1e-9 * got["K_p"][i])
        with mp.workdps(50):
            ratio = (wanted["omega_p"] / wanted["omega_r"]) ** 2
            # Eq. (37) [k-rat] in 50 digits.
            assert abs(wanted["K_p"] / wanted["K_r"] / ratio - 1) < mp.mpf(10) ** -40


@pytest.mark.parametrize("alpha", [3.7, 13.04])
def test_limits_to_fifty_digits(alpha):
    """T3 where doubles end: curvatures 1e-30 away from their limits."""
    beta, th, phi = 1.522, 0.6429, 0.036
    with mp.workdps(60):
        tiny, xi = mp.mpf(10) ** -30, -(mp.mpf(10) ** -20)
        lever = -xi * (1 / mp.mpf(beta) - 1 / mp.mpf(alpha))
        skew = mp.mpf(alpha) / beta
        flat = theory_mp.reference(alpha, beta, 12.28, th, tiny, xi, 0.1, 0.01)
        tall = theory_mp.reference(alpha, beta, 12.28, 1 - tiny, phi, xi, 0.1, 0.01)
        pairs = (
            (flat["K_r"], lever * skew * (1 / mp.mpf(th) - 1)),
            (flat["K_p"] * tiny, lever),
            (tall["K_p"], lever * (1 / mp.mpf(phi) - 1)),
            (tall["K_r"] / tiny, lever * skew),
        )
        for got, wanted in pairs:
            assert abs(got / wanted - 1) < mp.mpf(10) ** -27


def test_extrapolation_is_exact_for_quadratics():
    x = 2.0 ** -np.arange(3, 8)
    assert measures.extrapolated(5 + 3 * x - 7 * x**2) == pytest.approx(5, rel=1e-14)
    # A sequence with another limit is told apart.
    assert abs(measures.extrapolated(5.001 + x) - 5) > 5e-4


@pytest.mark.parametrize("bodies", [bodies.sd_bodies, bodies.wide_bodies])
def test_slopes_of_growth_against_fifty_digits(bodies):
    body = bodies(8, seed=11)
    pitch, roll = measures.growth_slopes(body)
    h = mp.mpf(10) ** -25
    for i, row in enumerate(np.stack(body, -1).tolist()):
        with mp.workdps(100):
            up, down = (theory_mp.growth_exact(*row, sign * h) for sign in (1, -1))
            slopes = [float((up[k].real - down[k].real) / (2 * h)) for k in (0, 1)]
        found = theory_mp.reference(*row, 0.1, 0.01)
        assert pitch[i] == pytest.approx(slopes[0], rel=1e-9)
        assert roll[i] == pytest.approx(slopes[1], abs=1e-9 * abs(slopes[0]))
        assert slopes[0] == pytest.approx(float(found["K_p"]) / 2, rel=1e-12)
        assert slopes[1] == pytest.approx(-float(found["K_r"]) / 2, rel=1e-9)


def test_moffatt_and_tokieda_have_the_same_orbit():
    """The map of T7 on a solution: both systems integrated by SciPy."""
    from scipy.integrate import solve_ivp

    K_p, K_r, inertia, ratio = 0.5, 0.1, 12.0, 5.0

    def ours(t, y):
        n, e_p, e_r = y
        return [(K_r * e_r - K_p * e_p) / inertia, K_p * n * e_p, -K_r * n * e_r]

    start, end = np.array([0.3, 0.2, 0.4]), 40.0  # P, R, S and tau
    theirs = solve_ivp(lambda t, y: measures.prs(y, ratio), (0, end), start, rtol=1e-10,
                       atol=1e-12).y[:, -1]  # fmt: skip
    p, r, s = start
    mapped = [s, inertia / 2 * p**2, inertia / 2 * r**2]
    n, e_p, e_r = solve_ivp(ours, (0, 2 / K_r * end), mapped, rtol=1e-10, atol=1e-12).y[:, -1]
    back = [np.sqrt(2 * e_p / inertia), np.sqrt(2 * e_r / inertia), n]
    np.testing.assert_allclose(back, theirs, atol=1e-7)
    assert np.abs(theirs - start).max() > 0.05


def test_ellipsoids_by_slices():
    # The half's centre of mass is 3/8 above the middle.
    half = bodies.by_slices("half", np.array([9.0]), np.array([2.89]))
    assert half["theta"] == pytest.approx(5 / 8 / 2.89, rel=1e-14)
    assert half["alpha"] == pytest.approx((64 * 9 + 144) / 125, rel=1e-14)
    whole = bodies.by_slices("whole", np.array([9.0]), np.array([2.89]))
    assert whole["beta"] == pytest.approx((2.89 + 6) / 5, rel=1e-14)
    for kind in bodies.LEAST:
        b2, c2 = bodies.shapes(kind, 200)
        assert np.all((b2 > c2) & (c2 > bodies.LEAST[kind]))
        assert np.all(bodies.by_slices(kind, b2, c2)["theta"] < 1)
        assert np.all(bodies.square_difference(kind, b2, c2) > 0)


def test_least_ratio_of_the_frequencies():
    ranges = SdRanges()
    bound = fig2.ratio_bound(ranges)
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
    assert fig2.ratio_bound(SdRanges(theta=[0.15, 0.2], phi=[0.05, 0.14])) == 1


@pytest.mark.parametrize(
    ("ranges", "verdict"),
    [
        ({"theta": [0.75, 0.95]}, "agree"),
        ({}, "partly"),
        (
            {"f_sd": [0.3, 0.45], "theta": [0.4, 0.5], "phi": [0.2, 0.39],
             "minus_xi_deg": [20.0, 30.0]},
            "disagree",
        ),
    ],
)  # fmt: skip
def test_t4_follows_the_measurement(ranges, verdict):
    tables = fig2.distributions(5000, SdRanges(**ranges), quiet)
    assert claim("T4", fig2=tables)["verdict"] == verdict


def test_t5_follows_the_measurement(fig3_tables):
    tables = dict(fig3_tables)
    share = tables["density"]["relative_frequency"].to_numpy() * 1e3
    place = tables["density"].schema.get_field_index("relative_frequency")
    tables["density"] = tables["density"].set_column(place, "relative_frequency", [share])
    assert claim("T5", fig3=tables)["verdict"] == "partly"
    # The two parts of the figure must be of the same bodies.
    others = SdRanges(theta=[0.6, 0.62], phi=[0.09, 0.1])
    other = fig3.distributions(20_000, 100, others, 1, quiet)
    tables = dict(fig3_tables) | {"cumulative": other["cumulative"]}
    assert claim("T5", fig3=tables)["verdict"] == "disagree"


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
        (bodies, "by_slices", changed(bodies.by_slices, alpha=1.1), ["T6"]),
        (measures, "by_definition", changed(measures.by_definition, K_r=1.001), ["T2"]),
    ],
)
def test_wrong_theory_is_found_out(monkeypatch, module, name, wrong, names):
    """Each claim disagrees with formulas that are a little wrong."""
    monkeypatch.setattr(module, name, wrong)
    assert [claim(each)["verdict"] for each in names] == ["disagree"] * len(names)
