"""At small oscillations type SS is where the spin exceeds Bondi's threshold, run by run."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

import rattlesweep as rs


def check(output: Path, **bodies: Any) -> rs.Sweep:
    """Every run of small oscillations agrees with the threshold."""
    config = {
        "seed": 2017,
        "bodies": {"source": "sd", **bodies},
        "spin": {"n_i": [-0.3, -0.4, -0.5], "omega_xy0": 0.001},
        "horizon": {"t_rgh": 5},
    }
    done = rs.sweep(config, output=output)
    runs = done.runs
    assert len(runs) >= 5000
    assert (runs.status == "ok").all()
    assert (runs.type == "SS").sum() > 100
    threshold = runs.n_c1.abs() < runs.n_i.abs()  # a null threshold is below nothing
    differ = runs[(runs.type == "SS") != threshold]
    assert differ.empty, differ[["case", "sample", "n_i", "n_c1", "type"]].to_string()
    return done


def test_three_targets(tmp_path: Path) -> None:
    done = check(tmp_path / "out", samples=560, target={"K_r": [0.01, 0.03, 0.1]})
    assert (done.summary.fraction_SS == done.summary.fraction_bondi).all()


@pytest.mark.slow
def test_without_a_target(tmp_path: Path) -> None:
    # Bodies with a skew angle near zero take horizons up to a million units of time.
    check(tmp_path / "out", samples=1700)
