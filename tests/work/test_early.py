"""`classify.early`: runs end once their type is certainly SS, and nothing else
changes.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import sweeping
from refusal import assert_refused
from sweeping import content_hash, invoke, proved, rows

import rattlesweep as rs
from rattlesweep.physics.body import PARAMETERS
from rattlesweep.work.run import Shard

SETS = (
    "bodies.samples=12",
    "bodies.target={K_r: [0.0041, 0.02], rel_tol: 0.1}",
    "spin.n_i=[-0.2, -0.5, 0.4]",
    "record=[energy, windows]",
)
EARLY = "classify.early=true"


def sweep(output: Path, *sets: str, **options: Any) -> Any:
    return sweeping.sweep(output, "steady.yaml", *SETS, *sets, **options)


@pytest.fixture(scope="module")
def both(tmp_path_factory) -> Path:
    """The same runs, up to their horizons and ended early."""
    root = tmp_path_factory.mktemp("early")
    sweep(root / "full")
    sweep(root / "early", EARLY)
    return root


def test_no_type_changes_and_steady_runs_take_a_fraction_of_their_steps(both):
    early = rows(both / "early")
    full = rows(both / "full")
    some = (early.t_end < full.t_end) & early.t_r.isna()
    assert early.type.equals(full.type)
    assert set(full.type) == {"R", "SS", "SW", "unclassified"}
    steady = full.type == "SS"
    assert steady[some].all()
    assert 10 < 0.8 * steady.sum() < some.sum()
    assert early.n_steps[steady].sum() < 0.3 * full.n_steps[steady].sum()
    pd.testing.assert_frame_equal(early[~some], full[~some], check_exact=True)
    # A run settles at the spin that corresponds to all of its energy.
    early = early[some]
    full = full[some]
    assert (early.status == "ok").all()
    assert (np.maximum(early.amp_growth, full.amp_growth) <= 0).all()
    np.testing.assert_allclose(early.n_end, -early.n_0, rtol=1e-14)
    np.testing.assert_allclose(early.n_end, full.n_end, rtol=1e-3)
    np.testing.assert_allclose(early.n_departure, full.n_departure, atol=1e-12)


def test_it_is_no_threshold_and_another_sweep(both):
    full = both / "full"
    done = invoke("classify", full, "--set", EARLY)
    assert_refused(done, 2, "classify.early: decides more than types")
    done = sweeping.run("steady.yaml", full, *SETS, EARLY, options=("-q",))
    assert_refused(done, 2, "holds another sweep (classify.early: false against true)")


@pytest.mark.slow
def test_the_same_content_however_it_is_run(both, tmp_path):
    for index, threads in enumerate((2, 1)):
        sweep(tmp_path, EARLY, shard=Shard(index, 2), threads=threads)
    assert proved(tmp_path, recompute=5) == content_hash(both / "early")
    assert content_hash(both / "early") != content_hash(both / "full")


def test_for_the_mirror_image(tmp_path):
    """The mirror image is stable in the other direction."""
    b = rs.Rattleback.gh()
    found = []
    for sign in (1, -1):
        body = [b.alpha, b.beta, b.gamma, 0.95, b.phi, sign * b.xi]
        table = pd.DataFrame([body], columns=list(PARAMETERS))
        spin = {"n_i": -0.5 * sign, "omega_xy0": 0.001}
        config = {"spin": spin, "horizon": {"t": 2000.0}, "classify": {"early": True}}
        found.append(
            rs.sweep(table, output=tmp_path / str(sign), **config).runs.iloc[0]
        )
    assert [run.type for run in found] == ["SS"] * 2
    early, mirrored = found
    assert early.t_end < 1000
    assert mirrored.t_end == pytest.approx(early.t_end, rel=1e-2)
    assert mirrored.n_end == pytest.approx(-early.n_end, rel=1e-12)
