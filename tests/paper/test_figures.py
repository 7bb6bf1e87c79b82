"""Figures of bodies and of single runs (2 to 4, 6b, 8), Lyapunov exponents, their claims."""

from __future__ import annotations

import math

import numpy as np
import oracle
import pandas as pd
import pyarrow as pa
import pytest
from telling import quiet

from rattlesweep.paper import columns
from rattlesweep.paper.claims.claim import claims, judge
from rattlesweep.paper.claims.runs import force_words
from rattlesweep.paper.figures import fig4, fig6, fig8, lyapunov
from rattlesweep.paper.figures.follow import FORCES, forces
from rattlesweep.paper.registry import FIGURES
from rattlesweep.analysis.onerun.figure import thin

GH = ("G1", "G2", "G3")


@pytest.fixture(scope="module")
def four():
    return fig4.first_reversals(quiet)


@pytest.fixture(scope="module")
def eight():
    # Long enough for three reversals of either model at each theta.
    return fig8.long_runs(quiet, t_end=1.7e4, tol=1e-12)


@pytest.fixture(scope="module")
def grown():
    return lyapunov.beside_fig8(2000.0, 2, quiet, tolerances=(1e-8, 1e-10))


# --------------------------------------------------------------------------------- helpers


def test_a_thinned_curve_keeps_ends_and_extremes_of_every_stretch():
    values = np.random.default_rng(1).normal(size=10_000)
    chosen = thin(values, 100)
    assert (np.diff(chosen) > 0).all()
    assert (chosen[0], chosen[-1]) == (0, len(values) - 1)
    assert len(chosen) <= 202
    kept = np.full(len(values), np.nan)
    kept[chosen] = values[chosen]
    for of in (np.nanmin, np.nanmax):
        np.testing.assert_array_equal(
            of(kept.reshape(100, 100), axis=1), of(values.reshape(100, 100), axis=1)
        )
    np.testing.assert_array_equal(thin(values[:150], 100), np.arange(150))


def test_forces_are_judged_only_while_the_body_presses_down():
    frame = pd.DataFrame(
        {"t": [0.0, 1.0, 2.0, 3.0], "F_normal": [1.0, 0.5, -0.1, 0.9],
         "F_tangential": [0.1, 0.2, 5.0, 0.3]}
    )  # fmt: skip
    row = columns.table([forces("x", frame)], FORCES).to_pylist()[0]
    assert (row["ratio_max"], row["ratio_t"]) == (0.4, 1.0)
    assert (row["normal_min"], row["normal_t"], row["t_end"]) == (-0.1, 2.0, 3.0)
    assert (row["slip_t"], row["open_t"]) == (None, 2.0)
    assert "would be lost at t = 2.0" in force_words(row)


def test_maxima_of_a_modulus_and_their_frequency():
    t = np.arange(0, 60, 0.02)
    times, sizes = fig4.maxima(t, 0.3 * np.cos(1.44 * t + 0.4))
    exact = (np.pi * np.arange(1, len(times) + 1) - 0.4) / 1.44
    np.testing.assert_allclose(times, exact, atol=1e-5)
    np.testing.assert_allclose(sizes, 0.3, rtol=1e-6)
    assert fig4.frequency(times, 30.0, 10.0) == pytest.approx(1.44, rel=1e-6)
    assert fig4.frequency(times, None, 10.0) is None
    assert fig4.frequency(times, 500.0, 10.0) is None


def test_zeros_near_each_other_are_one_reversal():
    groups = fig8.reversals([1.0, 2.0, 5.0, 50.0, 100.0, 103.0], 10.0)
    assert [list(g) for g in groups] == [[1.0, 2.0, 5.0], [50.0], [100.0, 103.0]]
    assert fig8.reversals([], 10.0) == []


# ---------------------------------------------------------------------------------- Fig. 4


@pytest.mark.slow
def test_reversals_of_fig_4_are_those_of_another_integrator(four):
    rows = {row["run"]: row for row in four["runs"].to_pylist()}
    assert rows["unsteady"]["n_i"] == 0.1
    y0 = oracle.launch(oracle.GH, 0.1, 0.01, oracle.relevant_psi(oracle.GH, 0.1))
    t_r = oracle.first_zero(oracle.GH, y0, 150.0, rtol=1e-10, atol=1e-13)[0]
    assert rows["unsteady"]["t_r"] == pytest.approx(t_r, abs=1e-5)
    modes = oracle.modes(oracle.GH)
    assert rows["steady"]["omega_relevant"] == pytest.approx(modes["omega_r"], rel=1e-12)
    # The paper's Eq. (56) [trgh-p].
    n_0 = math.sqrt(0.01 + 1e-4 * inertia(0.1) / 12.28)
    t_rgh = math.log((n_0 + 0.1) / (n_0 - 0.1)) / (n_0 * modes["K_p"])
    assert rows["unsteady"]["t_rgh"] == pytest.approx(t_rgh, rel=1e-9)


def inertia(n_i):
    """Of GH about the horizontal axis of its launch."""
    psi = oracle.relevant_psi(oracle.GH, n_i)
    return 13.04 * math.cos(psi) ** 2 + 1.522 * math.sin(psi) ** 2


def test_claims_of_fig_4_follow_the_series(four):
    def judged(**changed):
        return {c["id"]: c for c in judge({"fig4": four | changed}, theory=False)}

    found = judged()
    assert {name: c["verdict"] for name, c in found.items()} == dict.fromkeys(GH, "agree")
    assert found["G3"]["value"] > 2
    late = [row | {"t_r": 2 * row["t_r"]} for row in four["runs"].to_pylist()]
    found = judged(runs=pa.Table.from_pylist(late, schema=fig4.RUNS))
    assert {name: c["verdict"] for name, c in found.items()} == dict.fromkeys(GH, "disagree")
    # With x and y exchanged every statement on them is wrong.
    frame = four["extrema"].to_pandas()
    frame["component"] = frame["component"].map({"omega_x": "omega_y", "omega_y": "omega_x"})
    swapped = judged(extrema=pa.Table.from_pandas(frame, preserve_index=False))["G3"]
    assert (swapped["verdict"], swapped["held"], swapped["checks"]) == ("disagree", 1, 6)


def test_a_large_mode_alone_swings_as_it_does_at_the_reversal(four):
    rows = {row["run"]: row for row in four["runs"].to_pylist()}
    assert rows["unsteady"]["frequency_free"] / rows["unsteady"]["omega_relevant"] < 0.97
    assert rows["steady"]["frequency_free"] / rows["steady"]["omega_relevant"] > 1.03
    small = fig4.free_frequency(1e-4, "omega_x", 80.0)
    assert small == pytest.approx(oracle.modes(oracle.GH)["omega_p"], rel=1e-5)


# ------------------------------------------------------------------------------- Fig. 6(b)


def runs_of_types():
    """Five runs of SS and of SW at the launches of Fig. 6(b), in no order."""
    rows = [
        {"type": kind, **at, "sample": k, "n_end": n, "n_departure": -n, "chaotic": False,
         "K_r": 0.1, "lyapunov_late": 0.0}
        for kind, at in (("SS", fig6.SS_AT), ("SW", fig6.SW_AT))
        for k, n in enumerate((-0.3, -0.1, -0.5, -0.2))
    ]  # fmt: skip
    return pd.DataFrame(rows)


def test_examples_are_chosen_by_their_rule():
    runs = runs_of_types()
    wobbling = runs[runs["type"] == "SW"]
    rows = {row["example"]: row for row in fig6.choose(runs, wobbling)}
    assert list(rows) == ["spin_ss", "spin_sw"]
    # The lower one of the two in the middle.
    assert (rows["spin_ss"]["n_end"], rows["spin_sw"]["n_departure"]) == (-0.3, 0.2)
    fast = wobbling.assign(**fig6.CHAOTIC_AT, chaotic=True, lyapunov_late=[1.0, 3.0, 2.0, 0.0])
    rows = {row["example"]: row for row in fig6.choose(runs[:0], fast)}
    assert list(rows) == ["spin_chaotic"]
    assert rows["spin_chaotic"]["sample"] == 1
    assert fig6.choose(runs[:0], wobbling[:0]) == []


def wobbling(slow=0, fast=40, total=1000):
    rows = [
        {"K_r": k, "n_i": n, "omega_xy0": 0.01, "chaotic": False, "growth_longer": np.nan}
        for n in (-0.3, -0.5) for k in (0.005, 0.08) for _ in range(total // 2)
    ]  # fmt: skip
    frame = pd.DataFrame(rows)
    frame.loc[frame.index[:slow], ["chaotic", "growth_longer"]] = [True, 50.0]
    fast_small = frame.index[(frame["n_i"] == -0.5) & (frame["K_r"] == 0.005)][:fast]
    frame.loc[fast_small, "chaotic"] = True
    return frame


def s5(runs):
    """The only claim that the runs settle, without the types of the sweep."""
    tables = {"fig6": {"chaos": pa.Table.from_pandas(runs, preserve_index=False)}}
    return claims()["S5"].judge(tables)


def test_one_chaotic_slow_run_is_enough_for_partly():
    assert s5(wobbling())["verdict"] == "agree"
    one = s5(wobbling(slow=1))
    assert one["verdict"] == "partly"
    assert one["low"] < one["value"] == 0.001 < one["high"] < 0.01
    assert "The 1 chaotic ones" in one["evidence"]
    assert s5(wobbling(slow=150, fast=0))["verdict"] == "disagree"
    assert s5(wobbling().query("n_i == -0.5")) is None


# ---------------------------------------------------------------------------------- Fig. 8


def test_the_reduced_model_begins_as_the_caption_says(eight):
    """E_p(0) is the launch's, E_r(0) is given: C_I and E_tot follow, and with them the period."""
    rows = eight["invariants"].to_pandas().query("model == 'reduced'")
    energy = 0.5 * 1e-4 * inertia(0.1)
    modes = oracle.modes(oracle.GH)
    c_i = oracle.reduced_C_I([0.1, energy, 3e-5], modes["K_p"], modes["K_r"])
    own = rows[rows["theta"] == 0.6429].iloc[0]
    assert own["casimir_low"] == pytest.approx(c_i, rel=1e-8)
    assert own["casimir_high"] == pytest.approx(c_i, rel=1e-8)


def test_runs_of_fig_8_are_the_papers(eight):
    full = eight["reversals"].to_pandas().query("model == 'full'")
    first = full.groupby("theta")["t"].first()
    assert first[0.6429] == pytest.approx(112.0939, abs=1e-3)
    # "the second spin reversal around 3000"
    assert full[full["theta"] == 0.82]["t"].iloc[1] == pytest.approx(3000, rel=0.01)
    reduced = eight["reversals"].to_pandas().query("model == 'reduced'")
    for _, own in reduced.groupby("theta"):
        gaps = np.diff(own["t"])
        np.testing.assert_allclose(gaps, gaps[0], rtol=1e-9)
    spin = eight["spin"].to_pandas()
    for _, own in spin.groupby("theta"):
        assert (np.diff(own["t"]) > 0).all()
        assert own["n"].abs().max() < 0.11
        assert own["n_reduced"].abs().max() < 0.11


def test_the_casimir_invariant_of_averaged_energies():
    t = np.arange(0, 100, 0.01)
    period = 10.0
    swing = np.cos(2 * np.pi * t / period)
    table = pd.DataFrame({"t": t, "E_p": 2e-3 * (1 + 0.9 * swing), "E_r": 5e-3 * (1 - 0.5 * swing)})
    found = fig8.averaged_casimir(type("T", (), {"table": table}), 0.55, 0.1, period)
    inside = (t > period) & (t < 90)
    wanted = math.log(2e-3) / 0.55 + math.log(5e-3) / 0.1
    np.testing.assert_allclose(found[inside], wanted, atol=0.02)


def exponents(growth):
    rows = [
        {"theta": theta, "tol": tol, "t_end": 1e5, "exponent": g / 5e4, "error": 1e-5, "growth": g}
        for theta, g in zip((0.6429, 0.82, 0.9), growth, strict=True) for tol in (1e-11, 1e-13)
    ]  # fmt: skip
    return pa.Table.from_pylist(rows, schema=lyapunov.EXPONENTS)


@pytest.mark.parametrize(
    ("growth", "verdict"),
    [((1, 100, 1), "agree"), ((1, 100, 20), "partly"), ((1, 1, 1), "disagree")],
)
def test_verdict_on_chaos_follows_the_exponents(eight, growth, verdict):
    figures = {"fig8": eight, "fig8_lyapunov": {"exponents": exponents(growth)}}
    found = {c["id"]: c for c in judge(figures, theory=False)}
    assert found["L1"]["verdict"] == verdict
    assert (found["L2"]["verdict"], found["L3"]["verdict"]) == ("agree", "agree")
    assert 0.18 < found["L3"]["value"] < 0.22
    assert ("narrow" in found["L1"]["evidence"]) == (growth[2] > 10)


def test_exponents_are_growth_over_time(grown):
    growth, rows = grown["growth"].to_pandas(), grown["exponents"].to_pylist()
    assert len(rows) == 6
    for row in rows:
        own = growth[(growth["theta"] == row["theta"]) & (growth["tol"] == row["tol"])]
        assert (np.diff(own["t"]) > 0).all()
        np.testing.assert_allclose(own["exponent"], own["growth"] / own["t"])
        end = own["growth"].iloc[-1] - own["growth"].iloc[own["t"].searchsorted(1000.0)]
        assert row["growth"] == pytest.approx(end)
        assert row["exponent"] == pytest.approx(end / 1000.0)
        assert row["error"] > 0


# -------------------------------------------------------------------------------- pictures


def test_pictures_of_the_runs(four, eight, grown):
    for name, tables, panels in (("fig4", four, 6), ("fig8", eight, 3),
                                 ("fig8_lyapunov", grown, 1)):  # fmt: skip
        figure = FIGURES[name].draw(tables)
        assert len(figure.axes) == panels
        for line in (line for axis in figure.axes for line in axis.lines):
            assert np.isfinite(np.asarray(line.get_xdata(), dtype=float)).all()
    first = FIGURES["fig4"].draw(four).axes[0]
    assert len(first.lines) == 4
