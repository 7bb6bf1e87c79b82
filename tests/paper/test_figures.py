"""Figures of single runs (5 and 9), phase volume, exponents, friction, and their claims."""

from __future__ import annotations

import math

import numpy as np
import oracle
import pandas as pd
import pytest

from rattlesweep.paper import fig5, fig9, friction
from rattlesweep.paper.claim import judge
from rattlesweep.paper.workspace import Sizes, Workspace
from rattlesweep.physics import full, steady


@pytest.fixture(scope="module")
def ws(tmp_path_factory):
    sizes = Sizes(friction=20, exponents_t_end=2000.0)
    return Workspace(tmp_path_factory.mktemp("paper"), sizes, threads=2)


@pytest.fixture(scope="module")
def five(ws):
    return fig5.data(ws)


@pytest.fixture(scope="module")
def nine(ws):
    with pytest.MonkeyPatch.context() as patch:
        # Long enough for three reversals of either model at each theta.
        patch.setattr(fig9, "T_END", 1.7e4)
        patch.setattr(fig9, "TOL", 1e-12)
        fig9.long_run.cache_clear()
        yield {"fig9": fig9.data(ws), "fig9_volume": fig9.volumes(ws)}
        fig9.long_run.cache_clear()


def verdicts(made):
    return {claim["id"]: claim["verdict"] for claim in judge(made, theory=False)}


# ---------------------------------------------------------------------------------- Fig. 5


def inertia():
    """Return the inertia of GH about the horizontal axis of its launch."""
    psi = oracle.relevant_psi(oracle.GH, 0.1)
    return 13.04 * math.cos(psi) ** 2 + 1.522 * math.sin(psi) ** 2


def test_claims_of_fig_5_follow_the_series(five):
    names = ("G1", "G2", "G3")
    assert verdicts({"fig5": five}) == dict.fromkeys(names, "agree")
    late = five | {"runs": five["runs"].assign(t_r=2 * five["runs"]["t_r"])}
    assert verdicts({"fig5": late}) == dict.fromkeys(names, "disagree")
    # With x and y exchanged every statement on them is wrong but one.
    other = {"omega_x": "omega_y", "omega_y": "omega_x"}
    shapes = five["envelopes"].assign(component=five["envelopes"]["component"].map(other))
    row = judge({"fig5": five | {"envelopes": shapes}}, theory=False)[2]
    assert (row["verdict"], row["held"], row["checks"]) == ("disagree", 1, 6)


# ---------------------------------------------------------------------------------- Fig. 9


@pytest.mark.parametrize(
    ("chaotic", "verdict"),
    [((0, 1, 0), "agree"), ((0, 1, 1), "partly"), ((0, 0, 0), "disagree")],
)
def test_verdict_on_chaos_follows_the_exponents(nine, chaotic, verdict):
    runs = pd.DataFrame({"theta": fig9.THETAS, "t_end": 1e5, "lyapunov_late": 1e-3,
                         "growth": 50.0, "chaotic": np.array(chaotic, bool)})  # fmt: skip
    found = {c["id"]: c for c in judge(nine | {"fig9_lyapunov": {"runs": runs}}, theory=False)}
    assert found["L1"]["verdict"] == verdict
    assert (found["L2"]["verdict"], found["L3"]["verdict"]) == ("agree", "agree")
    assert 0.18 < found["L3"]["value"] < 0.22
    assert ("narrow" in found["L1"]["evidence"]) == bool(chaotic[2])


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
        assert fig9.volume_rate(*state, *constants) == pytest.approx(wanted, abs=1e-6)
    # Near a steady spin it is n (K_p - K_r), the trace of the linear system.
    found = fig9.volume_rate(0.0, 0.0, 0.0, 0.0, 0.1, *constants)
    assert found == pytest.approx(np.trace(steady.matrix(constants, -0.1)), rel=1e-12)


def test_l4_follows_the_volume(nine):
    rates = nine["fig9_volume"]["rates"]

    def l4(**changed):
        return verdicts({"fig9_volume": {"rates": rates.assign(**changed)}})["L4"]

    assert l4() == "partly"
    assert l4(rate=-1.0, error=0.1) == "agree"
    assert l4(volume_low=0.0, volume_high=0.1) == "disagree"
    # In (a) the volume comes back, in the others it does not.
    assert (rates["volume_late"] > -1).tolist() == [True, False, False]


# ------------------------------------------------------------------- friction and pictures


def test_friction_keeps_more_and_more_bodies_from_reversing(ws, monkeypatch):
    monkeypatch.setattr(friction, "SIGMAS", (0.02, 0.3))
    tables = friction.data(ws)
    rows = tables["shares"]
    assert (rows["runs"] == 20).all()
    assert (rows[["one_way", "both", "neither", "steady_only"]].sum(axis=1) == 20).all()
    assert rows["neither"].is_monotonic_increasing
    assert rows["one_way"].iloc[0] > 10
    assert len(friction.draw(tables).axes) == 1
