"""A sweep with more samples or cases goes on from the runs of the smaller one, bit for bit."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import pytest
from hardship import Reference, check_finished
from sweeping import changed, content_hash, proved, sweep

from rattlesweep.errors import ConfigError
from rattlesweep.sweeps.shards import Shard
from rattlesweep.sweeps.old.merge import merge
from rattlesweep.sweeps.old.retype import retype

SMALL: dict[str, Any] = {
    "bodies": {"source": "sd", "samples": 12},
    "spin": {"n_i": [-0.1, 0.2], "omega_xy0": [0.01]},
    "model": "gh",
    "horizon": {"t": 1000},
    "block_size": 7,
}
LARGE = changed(SMALL, bodies={"samples": 31})
TARGET = {"K_r": [0.1], "rel_tol": 0.5}
AIMED = changed(SMALL, bodies={"target": TARGET})
SPIN = {"n_i": [-0.2, -0.1, 0.1, 0.2], "omega_xy0": [0.001, 0.01]}
STEPS = {
    "cases between the others": (SMALL, changed(SMALL, spin=SPIN)),
    "samples too": (SMALL, changed(SMALL, spin=SPIN, bodies={"samples": 13})),
    "a target more": (AIMED, changed(AIMED, bodies={"target": TARGET | {"K_r": [0.1, 0.05]}})),
    "of a sequence": (
        changed(SMALL, bodies={"draw": "sobol"}),
        changed(SMALL, bodies={"draw": "sobol", "samples": 40}),
    ),
}


@pytest.fixture(scope="module")
def large(tmp_path_factory) -> Path:
    """The larger sweep, begun as it is."""
    output = tmp_path_factory.mktemp("large") / "out"
    sweep(output, LARGE)
    return output


@pytest.mark.parametrize(("small", "more"), STEPS.values(), ids=STEPS)
def test_is_as_if_begun_with_more(small, more, tmp_path):
    whole, grown = tmp_path / "whole", tmp_path / "grown"
    sweep(whole, more)
    before = sweep(grown, small).runs
    result = sweep(grown, more)
    assert result.resumed_runs == before < result.runs
    assert result.done == result.runs - before
    assert any("those that are there are kept" in remark for remark in result.remarks)
    check_finished(grown, Reference.of(whole))
    proved(grown, recompute=20)


def test_step_by_step_with_a_damaged_block_and_other_types(large, tmp_path):
    sweep(tmp_path, SMALL)
    retype(tmp_path, ["classify.sw_departure=1e-6"])
    block = tmp_path / "runs" / "block-000001.parquet"
    block.write_bytes(block.read_bytes()[:-9])
    sweep(tmp_path, changed(SMALL, bodies={"samples": 20}))
    sweep(tmp_path, LARGE)
    check_finished(tmp_path, Reference.of(large))


def test_a_block_in_the_place_of_another_is_not_counted_twice(large, tmp_path):
    sweep(tmp_path, SMALL)
    runs = tmp_path / "runs"
    shutil.copy(runs / "block-000002.parquet", runs / "block-000001.parquet")
    assert sweep(tmp_path, LARGE).resumed_runs == 17
    check_finished(tmp_path, Reference.of(large))


def test_from_merged_shards_and_blocks_of_another_size(large, tmp_path):
    parts = [tmp_path / str(index) for index in range(2)]
    for index, part in enumerate(parts):
        sweep(part, SMALL | {"block_size": 5}, shard=Shard(index, 2))
    merge(parts, tmp_path / "merged")
    for grown in ("merged", "other"):
        sweep(tmp_path / grown, SMALL | {"block_size": 5})
        sweep(tmp_path / grown, LARGE)
        assert content_hash(tmp_path / grown) == content_hash(large)


FIRST = changed(AIMED, bodies={"target": TARGET | {"K_r": [0.05, 0.1]}})
REFUSED = {
    "fewer samples": (changed(SMALL, bodies={"samples": 11}), "more samples, but not fewer"),
    "a case less": (changed(SMALL, spin={"n_i": [-0.1, 0.3]}), "more cases, but none can go"),
    "another order": (changed(SMALL, spin={"n_i": [0.2, -0.1]}), "which keep their order"),
    "another seed too": (changed(LARGE, seed=1), "another config (seed: 0"),
    "another draw too": (changed(LARGE, bodies={"draw": "sobol"}), "bodies.draw"),
    "fewer steps": (changed(LARGE, integrator={"max_steps": 9}), "only grow"),
    "a target before": (FIRST, "new targets go behind"),
    "a share": (LARGE, "without --shard"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_is_no_growth_is_refused(name, tmp_path):
    config, words = REFUSED[name]
    small = AIMED if config is FIRST else SMALL
    sweep(tmp_path, small)
    before = Reference.of(tmp_path)
    with pytest.raises(ConfigError) as refused:
        sweep(tmp_path, config, shard=Shard(0, 2) if name == "a share" else None)
    assert len(refused.value.messages) == 1
    assert words in refused.value.messages[0]
    check_finished(tmp_path, before)
    assert sweep(tmp_path, small).resumed_runs == 24
