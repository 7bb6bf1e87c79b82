"""Figures of single runs (5 and 9), phase volume, friction, and their claims."""

from __future__ import annotations

import numpy as np
import pytest

from rattlesweep.paper import fig5_9, fig7
from rattlesweep.paper.claim import judge
from rattlesweep.paper.workspace import Sizes, Workspace


@pytest.fixture(scope="module")
def ws(tmp_path_factory):
    sizes = Sizes(friction=20, exponents_t_end=2000.0)
    return Workspace(tmp_path_factory.mktemp("paper"), sizes, threads=2)


@pytest.fixture(scope="module")
def nine(ws):
    with pytest.MonkeyPatch.context() as patch:
        # Long enough for three reversals of either model at each theta.
        patch.setattr(fig5_9, "T_END", 1.7e4)
        patch.setattr(fig5_9, "TOL", 1e-12)
        return fig5_9.long_runs(ws)


def verdicts(made):
    return {claim["id"]: claim["verdict"] for claim in judge(made, theory=False)}


def test_claims_of_fig_5_follow_the_series(ws):
    five = fig5_9.reversals(ws)
    names = ("G1", "G2", "G3")
    assert verdicts({"fig5": five}) == dict.fromkeys(names, "agree")
    late = five | {"runs": five["runs"].assign(t_r=1.5 * five["runs"]["t_r"])}
    assert set(verdicts({"fig5": late}).values()) == {"disagree"}
    # With x and y exchanged every statement on them is wrong but one.
    other = {"omega_x": "omega_y", "omega_y": "omega_x"}
    turned = {name: five[name].rename(columns=other) for name in fig5_9.ENDS}
    row = judge({"fig5": five | turned}, theory=False)[2]
    assert (row["verdict"], row["held"], row["checks"]) == ("disagree", 1, 6)


@pytest.mark.parametrize(
    ("chaotic", "verdict"),
    [((0, 1, 0), "agree"), ((0, 1, 1), "partly"), ((0, 0, 0), "disagree")],
)
def test_verdict_on_chaos_follows_the_exponents(nine, chaotic, verdict):
    runs = nine["runs"].assign(chaotic=np.array(chaotic, bool))
    found = {c["id"]: c for c in judge({"fig9": nine | {"runs": runs}}, theory=False)}
    assert found["L1"]["verdict"] == verdict
    assert (found["L2"]["verdict"], found["L3"]["verdict"]) == ("agree", "agree")
    assert 0.18 < found["L3"]["value"] < 0.22
    assert ("narrow" in found["L1"]["evidence"]) == bool(chaotic[2])


def test_l4_follows_the_volume(nine):
    def l4(**changed):
        return verdicts({"fig9": {"runs": nine["runs"].assign(**changed)}})["L4"]

    assert l4() == "partly"
    assert l4(rate=-1.0, error=0.1) == "agree"
    assert l4(volume_low=0.0, volume_high=0.1) == "disagree"
    # In (a) the volume comes back, in the others it does not.
    assert (nine["runs"]["volume_late"] > -1).tolist() == [True, False, False]


def test_friction_keeps_more_and_more_bodies_from_reversing(ws):
    tables = fig7.friction(ws)
    rows = tables["shares"]
    assert (rows["runs"] == 20).all()
    assert (rows[["one_way", "both", "neither", "steady_only"]].sum(axis=1) == 20).all()
    assert rows["neither"].is_monotonic_increasing
    assert rows["one_way"].max() > 10
    assert len(fig7.draw_friction(tables).axes) == 1
