"""`bodies.refine`: runs between others of one type are left out, the rest is the full grid's."""

from __future__ import annotations

import random
import shutil
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pytest
from stopping import again_and_again

from rattlesweep.errors import ConfigError
from rattlesweep.study.plots.layout import read_layout
from rattlesweep.study.plots.map import CODES, Map
from rattlesweep.study.plots.registry import read_picture
from rattlesweep.sweeps.cases.plan import make_plan
from rattlesweep.sweeps.cases.stages import make_stages, strides
from rattlesweep.sweeps.config.load import parse_config, physics_hash
from rattlesweep.sweeps.engines.run import run_sweep
from rattlesweep.sweeps.inspect.content_hash import content_hash
from rattlesweep.sweeps.inspect.verify import verify

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
    return run_sweep(make_plan(parse_config(config)), output, **options)


@pytest.fixture(scope="module")
def full(tmp_path_factory: pytest.TempPathFactory) -> Path:
    output = tmp_path_factory.mktemp("full") / "out"
    sweep(output, CONFIG | {"bodies": GRID})
    return output


@pytest.fixture(scope="module")
def refined(tmp_path_factory: pytest.TempPathFactory) -> Path:
    output = tmp_path_factory.mktemp("refined") / "out"
    sweep(output)
    return output


def picture(output: Path) -> Map:
    found = read_picture(read_layout(output), "map")
    assert isinstance(found, Map)
    return found


def test_a_fraction_of_the_runs_gives_the_same_map(full, refined):
    assert verify(refined, recompute=20).problems == []
    some = pd.read_parquet(refined / "runs").set_index(["case", "sample"]).sort_index()
    every = pd.read_parquet(full / "runs").set_index(["case", "sample"])
    assert len(every) == RUNS
    assert len(some) < RUNS / 4
    pd.testing.assert_frame_equal(some, every.loc[some.index])
    code, _ = picture(full).shown()
    inferred, _ = picture(refined).shown()
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
    runs = len(pd.read_parquet(tmp_path / "runs", columns=["case"]))
    assert runs < 0.5 * RUNS


def test_stopped_again_and_again_in_any_order(refined, tmp_path):
    dice = random.Random(1)

    def harm(trial: int) -> None:
        blocks = sorted((tmp_path / "runs").iterdir())
        if dice.random() < 0.3:
            dice.choice(blocks).unlink()
        assert not any("other stages" in text for text in verify(tmp_path).problems)

    again_and_again(partial(sweep, tmp_path), 4, dice, harm)
    assert content_hash(tmp_path) == content_hash(refined)
    assert (tmp_path / "summary.parquet").read_bytes() == (refined / "summary.parquet").read_bytes()


def test_whatever_the_blocks(refined, tmp_path):
    sweep(tmp_path, CONFIG | {"block_size": 777})
    assert content_hash(tmp_path) == content_hash(refined)


def test_goes_on_in_the_blocks_that_it_was_begun_in(refined, tmp_path):
    output = Path(shutil.copytree(refined, tmp_path / "out"))
    (output / "runs" / "block-000003.parquet").unlink()
    result = sweep(output, CONFIG | {"block_size": 40})
    assert any("was begun in blocks of 100 runs" in remark for remark in result.remarks)
    assert verify(output).problems == []
    assert content_hash(output) == content_hash(refined)


# -- where cells are halved ------------------------------------------------------------------------


def asked(kind: Any, axes: dict[str, int], **refine: Any) -> tuple[np.ndarray, np.ndarray, int]:
    """Which points of a plane of bodies are asked for; the types ``kind(x, y)``; stages."""
    names = ("theta", "phi")
    spans = {"theta": [0.6, 0.95], "phi": [0.02, 0.1]}
    ticks = {n: {"linspace": [*spans[n], axes[n]]} for n in names}
    config = parse_config(
        CONFIG
        | {
            "bodies": GRID | {"axes": ticks, "refine": refine},
            "spin": {"n_i": [-0.1, 0.1], "omega_xy0": 0.01},
        }
    )
    plan = make_plan(config)
    decide = make_stages(config, 2, plan.samples)
    assert decide is not None
    shape = tuple(axes[n] for n in names)
    x, y = np.meshgrid(*(np.linspace(0, 1, n) for n in shape), indexing="ij")
    truth = np.where(kind(x, y), "R", "SW")
    there = np.zeros((2, *shape), dtype=bool)
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
    there, truth, _ = asked(lambda x, y: x + 0.3 * y > 0.6, {"theta": 129, "phi": 129}, levels=4)
    assert there[1].sum() == 9 * 9
    differs = truth[1:] != truth[:-1]
    # Both sides of every step are known.
    assert (there[0][1:] & there[0][:-1])[differs].all()
    assert there[0].sum() < 0.1 * there[0].size


def test_a_boundary_that_hides_between_coarse_points_is_followed_to_its_ends():
    """A spiral arm thinner than the coarse cells, which meets them in a few places only."""
    there, truth, stages = asked(
        lambda x, y: np.abs(y - 0.5 - 0.3 * np.sin(7 * x)) < 0.025, {"theta": 257, "phi": 200},
        levels=4,
    )  # fmt: skip
    steps = truth[:, 1:] != truth[:, :-1]
    assert (there[0][:, 1:] & there[0][:, :-1])[steps].mean() > 0.97
    assert stages > 5
    assert there[0].sum() < 0.25 * there[0].size


def test_what_is_smaller_than_a_coarse_cell_may_be_missed():
    """The known weakness, which the docs measure."""
    island = lambda x, y: (x - 0.53) ** 2 + (y - 0.53) ** 2 < 0.02**2  # noqa: E731
    size = {"theta": 129, "phi": 129}
    assert asked(island, size, levels=4)[0][0].sum() == 9 * 9
    assert asked(island, size, levels=1)[0][0].sum() > 65 * 65


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
        make_plan(parse_config(CONFIG | {"bodies": few, "spin": {"n_i": 0.1, "omega_xy0": 0.1}}))
    by = GRID | {"refine": {"by": "lyapunov"}}
    with pytest.raises(ConfigError, match=r"refine\.by: there is no column lyapunov"):
        make_plan(parse_config(CONFIG | {"bodies": by}))


def test_the_hash_knows_it():
    plain, refined = (physics_hash(parse_config(c)) for c in (CONFIG | {"bodies": GRID}, CONFIG))
    assert plain != refined
