"""A sweep with more samples or cases goes on from the runs of the smaller one, bit for bit."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import pytest
from hardship import Reference, check_finished

from rattlesweep.errors import ConfigError
from rattlesweep.sweeps.cases.plan import make_plan
from rattlesweep.sweeps.cases.shards import Shard
from rattlesweep.sweeps.config.load import parse_config
from rattlesweep.sweeps.engines.run import run_sweep
from rattlesweep.sweeps.inspect.content_hash import content_hash
from rattlesweep.sweeps.inspect.merge import merge
from rattlesweep.sweeps.inspect.retype import retype
from rattlesweep.sweeps.inspect.verify import verify

SMALL: dict[str, Any] = {
    "bodies": {"source": "sd", "samples": 12},
    "spin": {"n_i": [-0.1, 0.2], "omega_xy0": [0.01]},
    "model": "gh",
    "horizon": {"t": 1000},
    "block_size": 7,
}
TARGET = {"K_r": [0.1], "rel_tol": 0.5}
SPIN = {"n_i": [-0.2, -0.1, 0.1, 0.2], "omega_xy0": [0.001, 0.01]}


def changed(base: dict[str, Any], **parts: Any) -> dict[str, Any]:
    return base | {
        key: base[key] | part if isinstance(part, dict) else part for key, part in parts.items()
    }


def sweep(output: Path, config: dict[str, Any], **options: Any) -> Any:
    return run_sweep(make_plan(parse_config(config)), output, **options)


AIMED = changed(SMALL, bodies={"target": TARGET})
STEPS = {
    "more samples": (SMALL, changed(SMALL, bodies={"samples": 31})),
    "cases between the others": (SMALL, changed(SMALL, spin=SPIN)),
    "both": (SMALL, changed(SMALL, spin=SPIN, bodies={"samples": 13})),
    "a target more": (AIMED, changed(AIMED, bodies={"target": TARGET | {"K_r": [0.1, 0.05]}})),
    "of a sequence": (
        changed(SMALL, bodies={"draw": "sobol"}),
        changed(SMALL, bodies={"draw": "sobol", "samples": 40}),
    ),
}


@pytest.mark.parametrize(("small", "large"), STEPS.values(), ids=STEPS)
def test_is_as_if_begun_with_more(small, large, tmp_path):
    whole, grown = tmp_path / "whole", tmp_path / "grown"
    sweep(whole, large)
    before = sweep(grown, small).runs
    result = sweep(grown, large)
    assert result.resumed_runs == before < result.runs
    assert result.done == result.runs - before
    assert any("those that are there are kept" in remark for remark in result.remarks)
    check_finished(grown, Reference.of(whole))
    assert verify(grown, recompute=20).problems == []


def test_in_blocks_of_another_size(tmp_path):
    large = changed(SMALL, bodies={"samples": 31})
    sweep(tmp_path / "whole", large)
    sweep(tmp_path / "grown", SMALL | {"block_size": 5})
    sweep(tmp_path / "grown", large)
    assert content_hash(tmp_path / "grown") == content_hash(tmp_path / "whole")


def test_step_by_step_with_a_damaged_block_and_other_types(tmp_path):
    whole, grown = tmp_path / "whole", tmp_path / "grown"
    sweep(whole, changed(SMALL, bodies={"samples": 31}))
    sweep(grown, SMALL)
    retype(grown, ["classify.sw_departure=1e-6"])
    block = grown / "runs" / "block-000001.parquet"
    block.write_bytes(block.read_bytes()[:-9])
    sweep(grown, changed(SMALL, bodies={"samples": 20}))
    sweep(grown, changed(SMALL, bodies={"samples": 31}))
    check_finished(grown, Reference.of(whole))


def test_a_block_in_the_place_of_another_is_not_counted_twice(tmp_path):
    large = changed(SMALL, bodies={"samples": 31})
    sweep(tmp_path / "whole", large)
    runs = tmp_path / "grown" / "runs"
    sweep(runs.parent, SMALL)
    shutil.copy(runs / "block-000002.parquet", runs / "block-000001.parquet")
    assert sweep(runs.parent, large).resumed_runs == 17
    check_finished(runs.parent, Reference.of(tmp_path / "whole"))


def test_after_shards_are_merged(tmp_path):
    parts = [tmp_path / str(index) for index in range(2)]
    for index, part in enumerate(parts):
        sweep(part, SMALL, shard=Shard(index, 2))
    merge(parts, tmp_path / "merged")
    large = changed(SMALL, bodies={"samples": 31})
    sweep(tmp_path / "merged", large)
    sweep(tmp_path / "whole", large)
    assert content_hash(tmp_path / "merged") == content_hash(tmp_path / "whole")


REFUSED = {
    "fewer samples": ({"bodies": {"samples": 11}}, "there can be more samples, but not fewer"),
    "a case less": ({"spin": {"n_i": [-0.1, 0.3]}}, "more cases, but none can go"),
    "another order": ({"spin": {"n_i": [0.2, -0.1]}}, "which keep their order"),
    "another seed too": ({"bodies": {"samples": 31}, "seed": 1}, "another config (seed: 0"),
    "another draw too": ({"bodies": {"samples": 31, "draw": "sobol"}}, "bodies.draw"),
    "fewer steps": ({"bodies": {"samples": 31}, "integrator": {"max_steps": 9}}, "only grow"),
}


@pytest.mark.parametrize(("change", "words"), REFUSED.values(), ids=REFUSED)
def test_what_is_no_growth_is_refused(change, words, tmp_path):
    sweep(tmp_path, SMALL)
    before = Reference.of(tmp_path)
    base = SMALL | {"integrator": {}}
    with pytest.raises(ConfigError) as refused:
        sweep(tmp_path, changed(base, **change))
    assert len(refused.value.messages) == 1
    assert words in refused.value.messages[0]
    check_finished(tmp_path, before)


def test_a_new_target_before_the_others_is_refused(tmp_path):
    sweep(tmp_path, AIMED)
    first = changed(AIMED, bodies={"target": TARGET | {"K_r": [0.05, 0.1]}})
    with pytest.raises(ConfigError, match="new targets go behind"):
        sweep(tmp_path, first)


def test_a_share_cannot_add(tmp_path):
    sweep(tmp_path, SMALL)
    with pytest.raises(ConfigError, match="without --shard"):
        sweep(tmp_path, changed(SMALL, bodies={"samples": 31}), shard=Shard(0, 2))
    assert sweep(tmp_path, SMALL).resumed_runs == 24
