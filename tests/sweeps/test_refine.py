"""`bodies.refine`: runs between others of one type are left out, the rest is the full grid's."""

from __future__ import annotations

import random
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pytest
import sweeping
from stopping import again_and_again
from sweeping import content_hash, plan_of, proved

from rattlesweep.errors import ConfigError
from rattlesweep.analysis.plots.layout import read_layout
from rattlesweep.analysis.plots.map import CODES
from rattlesweep.analysis.plots.kinds import choose_picture
from rattlesweep.sweeps.decide import make_stages, strides
from rattlesweep.sweeps.config.read import parse_config, physics_hash
from rattlesweep.sweeps.old.verify import verify

GRID: dict[str, Any] = {
    "source": "grid",
    "base": {"preset": "GH"},
    "axes": {"theta": {"linspace": [0.6, 0.99, 61]}},
}
CONFIG: dict[str, Any] = {
    "bodies": GRID | {"refine": {"levels": 3}},
    "spin": {"n_i": {"linspace": [-0.6, 0.6, 50]}, "omega_xy0": [0.01, 0.1]},
    "model": "gh",
    "horizon": {"t": 2000},
    "block_size": 100,
}
RUNS = 6100


def sweep(output: Path, config: dict[str, Any] = CONFIG, **options: Any) -> Any:
    return sweeping.sweep(output, config, **options)


@pytest.fixture(scope="module")
def full(tmp_path_factory) -> Path:
    output = tmp_path_factory.mktemp("full") / "out"
    sweep(output, CONFIG | {"bodies": GRID, "block_size": RUNS})
    return output


@pytest.fixture(scope="module")
def refined(tmp_path_factory) -> Path:
    output = tmp_path_factory.mktemp("refined") / "out"
    sweep(output)
    return output


def picture(output: Path) -> Any:
    return choose_picture(read_layout(output), "map")


def test_a_fraction_of_the_runs_gives_the_same_map(full, refined):
    proved(refined, recompute=20)
    keys = ["case", "sample"]
    some = pd.read_parquet(refined / "runs").set_index(keys).sort_index()
    every = pd.read_parquet(full / "runs").set_index(keys)
    assert len(every) == RUNS
    assert len(some) < RUNS / 4
    pd.testing.assert_frame_equal(some, every.loc[some.index])
    code, inferred = picture(full).shown()[0], picture(refined).shown()[0]
    assert CODES["missing"] not in inferred
    assert len(np.unique(code)) == 3
    assert np.mean(code != inferred) < 0.002
    assert "of 6,100; basin entropy" in picture(refined).words()


def test_times_between_runs_are_as_near_as_asked(full, tmp_path):
    sweep(tmp_path, CONFIG | {"bodies": GRID | {"refine": {"levels": 3, "by": "t_r"}}})
    (code, exact), (inferred, ratio) = picture(full).shown(), picture(tmp_path).shown()
    off = np.abs(ratio / exact - 1)[(code == inferred) & np.isfinite(exact) & np.isfinite(ratio)]
    assert (code == inferred).mean() > 0.99
    assert np.quantile(off, 0.98) < 0.05
    assert len(pd.read_parquet(tmp_path / "runs", columns=["case"])) < 0.5 * RUNS


def test_stopped_again_and_again_in_any_order_and_in_whatever_blocks(refined, tmp_path):
    dice, output = random.Random(1), tmp_path / "again"

    def harm(trial: int) -> None:
        if dice.random() < 0.3:
            dice.choice(sorted((output / "runs").iterdir())).unlink()
        assert not any("other stages" in text for text in verify(output).problems)

    assert again_and_again(partial(sweep, output), 4, dice, harm) > 2
    sweep(tmp_path / "other", CONFIG | {"block_size": 777})
    for directory in (output, tmp_path / "other"):
        assert proved(directory) == content_hash(refined)
    summary = (refined / "summary.parquet").read_bytes()
    assert (output / "summary.parquet").read_bytes() == summary
    # It goes on in the blocks that it was begun in.
    (output / "runs" / "block-000003.parquet").unlink()
    result = sweep(output, CONFIG | {"block_size": 40})
    assert any("was begun in blocks of 100 runs" in remark for remark in result.remarks)
    assert proved(output) == content_hash(refined)


# -- where cells are halved ------------------------------------------------------------------------


def asked(kind: Any, theta: int, phi: int, levels: int) -> tuple[np.ndarray, np.ndarray, int]:
    """Which points of a plane of bodies are asked for; the types ``kind(x, y)``; stages."""
    axes = {"theta": {"linspace": [0.6, 0.95, theta]}, "phi": {"linspace": [0.02, 0.1, phi]}}
    spin = {"n_i": [-0.1, 0.1], "omega_xy0": 0.01}
    plan = plan_of(CONFIG, bodies=GRID | {"axes": axes, "refine": {"levels": levels}}, spin=spin)
    decide = make_stages(plan.config, 2, plan.samples)
    assert decide is not None
    x, y = np.meshgrid(np.linspace(0, 1, theta), np.linspace(0, 1, phi), indexing="ij")
    truth = np.where(kind(x, y), "R", "SW")
    there = np.zeros((2, theta, phi), dtype=bool)
    numbers, stages = decide.first(), 0
    while len(numbers):
        assert not there.ravel()[numbers].any()
        assert (np.diff(numbers) > 0).all()
        there.ravel()[numbers] = True
        case, sample = np.divmod(numbers, plan.samples)
        # Of the second spin all runs are of one type.
        words = np.where(case == 0, truth.ravel()[sample], "R")
        columns = [pa.array(case), pa.array(sample), pa.array(words), pa.array(["ok"] * len(case))]
        decide.add(pa.record_batch(columns, names=["case", "sample", "type", "status"]))
        numbers, stages = decide.next(), stages + 1
    return there, truth, stages


def test_each_spin_is_a_picture_of_its_own_and_only_boundaries_are_refined():
    there, truth, _ = asked(lambda x, y: x + 0.3 * y > 0.6, 129, 129, levels=4)
    assert there[1].sum() == 9 * 9
    # Both sides of every step are known.
    assert (there[0][1:] & there[0][:-1])[truth[1:] != truth[:-1]].all()
    assert there[0].sum() < 0.1 * there[0].size


def test_a_boundary_that_hides_between_coarse_points_is_followed_to_its_ends():
    """A spiral arm thinner than the coarse cells, which meets them in a few places only."""
    arm = lambda x, y: np.abs(y - 0.5 - 0.3 * np.sin(7 * x)) < 0.025  # noqa: E731
    there, truth, stages = asked(arm, 257, 200, levels=4)
    steps = truth[:, 1:] != truth[:, :-1]
    assert (there[0][:, 1:] & there[0][:, :-1])[steps].mean() > 0.97
    assert stages > 5
    assert there[0].sum() < 0.25 * there[0].size


def test_what_is_smaller_than_a_coarse_cell_may_be_missed():
    """The known weakness, which the docs measure."""
    island = lambda x, y: (x - 0.53) ** 2 + (y - 0.53) ** 2 < 0.02**2  # noqa: E731
    assert asked(island, 129, 129, levels=4)[0][0].sum() == 9 * 9
    assert asked(island, 129, 129, levels=1)[0][0].sum() > 65 * 65


@pytest.mark.parametrize(
    ("shape", "levels", "expected"),
    [((400, 2, 400), 4, (16, 1, 16)), ((9, 9), 4, (4, 4)), ((4, 5), 1, (1, 2)), ((17,), 3, (8,))],
)
def test_coarse_grids(shape, levels, expected):
    assert strides(shape, levels) == expected


# -- what is wrong ---------------------------------------------------------------------------------


def test_refused_where_nothing_can_be_left_out_or_recorded():
    few = GRID | {"axes": {"theta": [0.6, 0.7, 0.8]}, "refine": {}}
    with pytest.raises(ConfigError, match="no axis has 5 values or more"):
        plan_of(CONFIG, bodies=few, spin={"n_i": 0.1, "omega_xy0": 0.1})
    with pytest.raises(ConfigError, match=r"refine\.by: there is no column lyapunov"):
        plan_of(CONFIG, bodies=GRID | {"refine": {"by": "lyapunov"}})
    assert physics_hash(parse_config(CONFIG)) != physics_hash(
        parse_config(CONFIG | {"bodies": GRID})
    )
