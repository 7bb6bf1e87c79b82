"""Figures of single runs (5, 6b, 7b, 9), phase volume, exponents, friction, and their claims."""

from __future__ import annotations

import math

import numpy as np
import oracle
import pandas as pd
import pytest

from rattlesweep.paper.claims.claim import judge
from rattlesweep.paper.claims.motions import force_words
from rattlesweep.paper.figures import chaos, fig5, fig7, fig9, friction, volume
from rattlesweep.paper.figures.single import forces
from rattlesweep.paper.parts import PARTS
from rattlesweep.paper.workspace import Sizes, Workspace
from rattlesweep.physics import full, steady

GH = ("G1", "G2", "G3")


def ignore(share):
    assert 0 <= share <= 1


@pytest.fixture(scope="module")
def five():
    return fig5.data(ignore)


@pytest.fixture(scope="module")
def nine():
    # Long enough for three reversals of either model at each theta.
    return fig9.data(ignore, t_end=1.7e4, tol=1e-12)


@pytest.fixture(scope="module")
def volumes():
    return volume.data(ignore)


def test_forces_are_judged_only_while_the_body_presses_down():
    frame = pd.DataFrame(
        {"t": [0.0, 1.0, 2.0, 3.0], "F_normal": [1.0, 0.5, -0.1, 0.9],
         "F_tangential": [0.1, 0.2, 5.0, 0.3]}
    )  # fmt: skip
    row = forces("x", frame)
    assert (row["ratio_max"], row["ratio_t"]) == (0.4, 1.0)
    assert (row["normal_min"], row["normal_t"], row["t_end"]) == (-0.1, 2.0, 3.0)
    assert math.isnan(row["slip_t"])
    assert row["open_t"] == 2.0
    assert "would be lost at t = 2.0" in force_words(row)


# ---------------------------------------------------------------------------------- Fig. 5


def test_maxima_of_a_modulus_and_their_frequency():
    t = np.arange(0, 60, 0.02)
    times, sizes = fig5.maxima(t, 0.3 * np.cos(1.44 * t + 0.4))
    exact = (np.pi * np.arange(1, len(times) + 1) - 0.4) / 1.44
    np.testing.assert_allclose(times, exact, atol=1e-5)
    np.testing.assert_allclose(sizes, 0.3, rtol=1e-6)
    assert fig5.frequency(times, 30.0, 10.0) == pytest.approx(1.44, rel=1e-6)
    assert math.isnan(fig5.frequency(times, 500.0, 10.0))


def inertia(n_i):
    """Return the inertia of GH about the horizontal axis of its launch."""
    psi = oracle.relevant_psi(oracle.GH, n_i)
    return 13.04 * math.cos(psi) ** 2 + 1.522 * math.sin(psi) ** 2


@pytest.mark.slow
def test_reversals_of_fig_5_are_those_of_another_integrator(five):
    rows = five["runs"].set_index("run")
    y0 = oracle.launch(oracle.GH, 0.1, 0.01, oracle.relevant_psi(oracle.GH, 0.1))
    t_r = oracle.first_zero(oracle.GH, y0, 150.0, rtol=1e-10, atol=1e-13)[0]
    assert rows["t_r"]["unsteady"] == pytest.approx(t_r, abs=1e-5)
    modes = oracle.modes(oracle.GH)
    assert rows["omega_relevant"]["steady"] == pytest.approx(modes["omega_r"], rel=1e-12)
    # The paper's Eq. (56) [trgh-p].
    n_0 = math.sqrt(0.01 + 1e-4 * inertia(0.1) / 12.28)
    t_rgh = math.log((n_0 + 0.1) / (n_0 - 0.1)) / (n_0 * modes["K_p"])
    assert rows["t_rgh"]["unsteady"] == pytest.approx(t_rgh, rel=1e-9)


def test_claims_of_fig_5_follow_the_series(five):
    def judged(**changed):
        return {c["id"]: c for c in judge({"fig5": five | changed}, theory=False)}

    found = judged()
    assert {name: c["verdict"] for name, c in found.items()} == dict.fromkeys(GH, "agree")
    assert found["G3"]["value"] > 2
    late = judged(runs=five["runs"].assign(t_r=2 * five["runs"]["t_r"]))
    assert {name: c["verdict"] for name, c in late.items()} == dict.fromkeys(GH, "disagree")
    # With x and y exchanged every statement on them is wrong.
    other = {"omega_x": "omega_y", "omega_y": "omega_x"}
    swapped = five["extrema"].assign(component=five["extrema"]["component"].map(other))
    row = judged(extrema=swapped)["G3"]
    assert (row["verdict"], row["held"], row["checks"]) == ("disagree", 1, 6)


def test_a_large_mode_alone_swings_as_it_does_at_the_reversal(five):
    rows = five["runs"].set_index("run")
    ratio = rows["frequency_free"] / rows["omega_relevant"]
    assert ratio["unsteady"] < 0.97
    assert ratio["steady"] > 1.03
    small = fig5.free_frequency(1e-4, "omega_x", 80.0)
    assert small == pytest.approx(oracle.modes(oracle.GH)["omega_p"], rel=1e-5)


# ------------------------------------------------------------------------------- Fig. 7(b)


def test_examples_are_chosen_by_their_rule():
    runs = pd.DataFrame(
        [{"type": kind, **at, "sample": k, "n_end": n, "n_departure": -n, "chaotic": False,
          "K_r": 0.1, "lyapunov_late": 0.0}
         for kind, at in (("SS", fig7.SS_AT), ("SW", fig7.SW_AT))
         for k, n in enumerate((-0.3, -0.1, -0.5, -0.2))]
    )  # fmt: skip
    wobbling = runs[runs["type"] == "SW"]
    rows = {row["example"]: row for row in fig7.choose(runs, wobbling)}
    assert list(rows) == ["spin_ss", "spin_sw"]
    # The lower one of the two in the middle.
    assert (rows["spin_ss"]["n_end"], rows["spin_sw"]["n_departure"]) == (-0.3, 0.2)
    fast = wobbling.assign(chaotic=True, lyapunov_late=[1.0, 3.0, 2.0, 0.0])
    (row,) = fig7.choose(runs[:0], fast)
    assert (row["example"], row["sample"]) == ("spin_chaotic", 1)
    assert fig7.choose(runs[:0], wobbling[:0]) == []


# ---------------------------------------------------------------------------------- Fig. 9


def test_zeros_near_each_other_are_one_reversal():
    groups = fig9.reversals([1.0, 2.0, 5.0, 50.0, 100.0, 103.0], 10.0)
    assert [list(g) for g in groups] == [[1.0, 2.0, 5.0], [50.0], [100.0, 103.0]]
    assert fig9.reversals([], 10.0) == []


def test_the_reduced_model_begins_as_the_caption_says(nine):
    """E_p(0) is the launch's, E_r(0) is given: C_I and E_tot follow, and with them the period."""
    rows = nine["invariants"].query("model == 'reduced' and theta == 0.6429").iloc[0]
    energy, modes = 0.5 * 1e-4 * inertia(0.1), oracle.modes(oracle.GH)
    c_i = oracle.reduced_C_I([0.1, energy, 3e-5], modes["K_p"], modes["K_r"])
    assert rows["casimir_low"] == pytest.approx(c_i, rel=1e-8)
    assert rows["casimir_high"] == pytest.approx(c_i, rel=1e-8)


def test_runs_of_fig_9_are_the_papers(nine):
    whole = nine["reversals"].query("model == 'full'")
    assert whole.groupby("theta")["t"].first()[0.6429] == pytest.approx(112.0939, abs=1e-3)
    # "the second spin reversal around 3000"
    assert whole[whole["theta"] == 0.82]["t"].iloc[1] == pytest.approx(3000, rel=0.01)
    for _, own in nine["reversals"].query("model == 'reduced'").groupby("theta"):
        gaps = np.diff(own["t"])
        np.testing.assert_allclose(gaps, gaps[0], rtol=1e-9)
    for _, own in nine["spin"].groupby("theta"):
        assert (np.diff(own["t"]) > 0).all()
        assert own[["n", "n_reduced"]].abs().max().max() < 0.11


def test_the_casimir_invariant_of_averaged_energies():
    t, period = np.arange(0, 100, 0.01), 10.0
    swing = np.cos(2 * np.pi * t / period)
    table = pd.DataFrame({"t": t, "E_p": 2e-3 * (1 + 0.9 * swing), "E_r": 5e-3 * (1 - 0.5 * swing)})
    found = fig9.averaged_casimir(table, 0.55, 0.1, period)
    inside = (t > period) & (t < 90)
    wanted = math.log(2e-3) / 0.55 + math.log(5e-3) / 0.1
    np.testing.assert_allclose(found[inside], wanted, atol=0.02)


def exponents(growth):
    return pd.DataFrame(
        [{"theta": theta, "tol": tol, "t_end": 1e5, "exponent": g / 5e4, "error": 1e-5,
          "growth": g}
         for theta, g in zip((0.6429, 0.82, 0.9), growth, strict=True) for tol in (1e-11, 1e-13)]
    )  # fmt: skip


@pytest.mark.parametrize(
    ("growth", "verdict"),
    [((1, 100, 1), "agree"), ((1, 100, 20), "partly"), ((1, 1, 1), "disagree")],
)
def test_verdict_on_chaos_follows_the_exponents(nine, growth, verdict):
    made = {"fig9": nine, "fig9_lyapunov": {"exponents": exponents(growth)}}
    found = {c["id"]: c for c in judge(made, theory=False)}
    assert found["L1"]["verdict"] == verdict
    assert (found["L2"]["verdict"], found["L3"]["verdict"]) == ("agree", "agree")
    assert 0.18 < found["L3"]["value"] < 0.22
    assert ("narrow" in found["L1"]["evidence"]) == (growth[2] > 10)


def test_exponents_are_growth_over_time(tmp_path):
    ws = Workspace(tmp_path, Sizes(exponents_t_end=2000.0), threads=2)
    grown = chaos.long_runs(ws, tolerances=(1e-8, 1e-10))
    assert len(grown["exponents"]) == 6
    for row in grown["exponents"].to_dict("records"):
        own = grown["growth"].query(f"theta == {row['theta']} and tol == {row['tol']}")
        assert (np.diff(own["t"]) > 0).all()
        np.testing.assert_allclose(own["exponent"], own["growth"] / own["t"])
        end = own["growth"].iloc[-1] - own["growth"].iloc[own["t"].searchsorted(1000.0)]
        assert row["growth"] == pytest.approx(end)
        assert row["exponent"] == pytest.approx(end / 1000.0)
    assert len(chaos.draw(grown).axes) == 1


# ---------------------------------------------------------------------------- phase volume


def test_the_volume_rate_is_the_derivative_of_a_small_volume():
    """Six neighbours on the sphere and in omega, moved for a short time by the equations."""
    rng = np.random.default_rng(5)
    constants = full.constants(13.04, 1.522, 12.28, 0.82, 0.036, -0.03)
    for state in np.column_stack([rng.normal(0, 0.2, (10, 2)), rng.normal(0, 0.3, (10, 3))]):

        def rates(y):
            return np.array(full.rhs(*y, *constants))

        step = 1e-5
        jacobian = np.array(
            [(rates(state + step * e) - rates(state - step * e)) / (2 * step) for e in np.eye(5)]
        )
        # The area of the sphere of directions by (p, q) is (1 + p^2 + q^2)^(-3/2) dp dq.
        p, q = state[:2]
        dp, dq = rates(state)[:2]
        density = -3 * (p * dp + q * dq) / (1 + p**2 + q**2)
        wanted = np.trace(jacobian) + density
        assert volume.volume_rate(*state, *constants) == pytest.approx(wanted, abs=1e-6)


def test_near_a_steady_spin_the_rate_is_that_of_the_linear_system():
    constants = full.constants(13.04, 1.522, 12.28, 0.82, 0.036, np.radians(-1.72))
    found = volume.volume_rate(0.0, 0.0, 0.0, 0.0, 0.1, *constants)
    linear = steady.matrix(constants, -0.1)
    assert found == pytest.approx(np.trace(linear), rel=1e-12)
    closed = 0.5 * math.sin(2 * math.radians(-1.72)) * (1 / 1.522 - 1 / 13.04)
    assert found == pytest.approx(0.1 * closed * (1 / 0.036 - 1 / 0.82), rel=1e-3)


def test_l4_follows_the_volume(volumes):
    rates = volumes["rates"]

    def l4(**changed):
        (row,) = judge({"fig9_volume": {"rates": rates.assign(**changed)}}, theory=False)
        return row["verdict"]

    assert l4() == "partly"
    assert l4(rate=-1.0, error=0.1) == "agree"
    assert l4(volume_low=0.0, volume_high=0.1) == "disagree"
    # In (a) the volume comes back, in the others it does not.
    assert (rates["volume_late"] > -1).tolist() == [True, False, False]
    assert len(volume.draw(volumes).axes) == 3


# -------------------------------------------------------------------------------- friction


def test_friction_keeps_more_and_more_bodies_from_reversing(tmp_path, monkeypatch):
    monkeypatch.setattr(friction, "SIGMAS", (0.02, 0.3))
    tables = friction.data(Workspace(tmp_path, Sizes(friction=20), threads=2))
    rows = tables["shares"]
    assert (rows["runs"] == 20).all()
    assert (rows[["one_way", "both", "neither", "steady_only"]].sum(axis=1) == 20).all()
    assert rows["neither"].is_monotonic_increasing
    assert rows["one_way"].iloc[0] > 10
    assert len(friction.draw(tables).axes) == 1


# -------------------------------------------------------------------------------- pictures


def test_pictures_of_the_runs(five, nine):
    for name, tables, panels in (("fig5", five, 6), ("fig9", nine, 3)):
        figure = PARTS[name].draw(tables)
        assert len(figure.axes) == panels
        for line in (line for axis in figure.axes for line in axis.lines):
            assert np.isfinite(np.asarray(line.get_xdata(), dtype=float)).all()
