"""Rows are equal however a sweep is cut, shared, ordered, stopped, grown or mended."""

from __future__ import annotations

import random
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import sweeping
from cutting import Stop, cut
from hardship import check_equal
from sweeping import changed, plan_of

from rattlesweep.kernel.threads import available_threads
from rattlesweep.store.merge import merge
from rattlesweep.store.rows import open_stored, same_bits
from rattlesweep.words.errors import ConfigError, OutputError
from rattlesweep.work.job import Job, Keys
from rattlesweep.work.run import Shard, integrate_plan, local

# Under the full model, of runs that take from 200 to 20,000 steps.
FULL: dict[str, Any] = {
    "bodies": {
        "source": "sd",
        "samples": 8,
        "target": {"K_r": [0.02, 0.1], "rel_tol": 0.1},
    },
    "spin": {"n_i": [-0.1, -0.3, -0.5], "omega_xy0": 0.01},
    "horizon": {"t_rgh": 3, "t": 2000},
    "record": ["windows"],
}
RUNS = 48
SMALL: dict[str, Any] = {
    "bodies": {"source": "sd", "samples": 12},
    "spin": {"n_i": [-0.1, 0.2], "omega_xy0": [0.01]},
    "model": "gh",
    "horizon": {"t": 1000},
}
LARGE = changed(SMALL, bodies={"samples": 31})
TARGET = {"K_r": [0.1], "rel_tol": 0.5}
AIMED = changed(SMALL, bodies={"target": TARGET})
SPIN = {"n_i": [-0.2, -0.1, 0.1, 0.2], "omega_xy0": [0.001, 0.01]}


def sweep(output: Path, config: dict[str, Any] = FULL, **options: Any) -> Any:
    return sweeping.sweep(output, config, **options)


@pytest.fixture(scope="module")
def whole(tmp_path_factory) -> Path:
    """The sweep, run without interruptions by one thread."""
    output = tmp_path_factory.mktemp("whole") / "out"
    result = sweep(output, threads=1)
    assert (result.runs, result.done) == (RUNS, RUNS)
    assert not result.failed
    return output


@pytest.mark.parametrize(("rows", "threads"), [(1, 2), (16, 1), (47, 2), (1000, 1)])
def test_blocks_and_threads_and_the_order_of_blocks(rows, threads, whole, tmp_path):
    executor = cut(rows, dice=random.Random(1))
    sweep(tmp_path, threads=min(threads, available_threads()), executor=executor)
    assert len(open_stored(tmp_path).files()) == -(-RUNS // rows)
    check_equal(tmp_path, whole)


SLIDES = ["t_slide", "n_slides", "slide_work"]
HOLDS = ["t_held", "held_time", "pivot_work"]
ERRORS = ["t_r_error", "n_departure_error"]
# Losses, what is recorded, and columns of each kind of friction.
FRICTION = {
    "mu": ({"mu": [0.2, 0.4]}, ["contact"], SLIDES),
    "pivot": ({"pivot": [2e-3, 1e-2]}, ["contact"], HOLDS),
    "viscous": ({"viscous": [30, 300]}, [], ["slip_work"]),
    "both": (
        {"mu": [0.1, 0.2], "pivot": 2e-3},
        ["contact", "error"],
        [*SLIDES, *HOLDS, *ERRORS],
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", FRICTION)
def test_runs_with_friction(name, tmp_path):
    """They slide, or their spin is held, each at times of its own."""
    losses, record, columns = FRICTION[name]
    # On ellipsoids, in the kernel in which test_slide_cases follows the oracle's.
    surface = {"surface": "ellipsoid", "c": 3} if name == "both" else {}
    config = changed(FULL, dissipation=losses, record=record, bodies=surface)
    sweep(tmp_path / "whole", config, threads=1)
    rows = open_stored(tmp_path / "whole").read().to_pandas()
    for column, least in (("t_slide", 0.4), ("t_held", 0.2)):
        if column in columns:
            assert rows[column].notna().mean() > least
    for index in (1, 2, 0):
        shard = Shard(index, 3)
        threads = min(2, available_threads())
        executor = cut(7, dice=random.Random(2))
        sweep(tmp_path / "cut", config, shard=shard, threads=threads, executor=executor)
    check_equal(tmp_path / "cut", tmp_path / "whole")
    halves = [tmp_path / "half-0", tmp_path / "half-1"]
    for index, half in enumerate(halves):
        sweep(half, config, shard=Shard(index, 2), executor=cut(11))
    merge(halves, tmp_path / "merged")
    check_equal(tmp_path / "merged", tmp_path / "whole")
    stops = 0
    while stops < 100:
        try:
            sweep(
                tmp_path / "stopped", config, executor=cut(9, 3, random.Random(stops))
            )
            break
        except Stop:
            stops += 1
    assert stops > 2
    check_equal(tmp_path / "stopped", tmp_path / "whole")
    varied = next(iter(losses))
    first_only = losses | {varied: losses[varied][:1]}
    for samples, friction in ((5, first_only), (5, losses), (8, losses)):
        part = changed(config, dissipation=friction, bodies={"samples": samples})
        sweep(tmp_path / "grown", part)
    grown = open_stored(tmp_path / "grown").read().to_pandas()
    order = [varied, "n_i", "K_r", "sample"]
    assert len(grown) == 2 * RUNS
    for column in ("t_r", "n_end", "energy_drift", "n_steps", *columns):
        first, second = (each.sort_values(order)[column] for each in (rows, grown))
        assert np.array_equal(first, second, equal_nan=True), column


def test_in_memory(whole):
    assert same_bits(integrate_plan(plan_of(FULL)), open_stored(whole).read())


def test_shards_in_one_directory(whole, tmp_path):
    results = [
        sweep(tmp_path, shard=Shard(index, 3), executor=cut(5)) for index in (2, 0, 1)
    ]
    check_equal(tmp_path, whole)
    assert [result.runs for result in results] == [RUNS // 3] * 3
    assert [result.missing for result in results] == [32, 16, 0]
    assert [result.summary is not None for result in results] == [False, False, True]


def test_broken_off_again_and_again_moved_and_harmed(whole, tmp_path):
    dice = random.Random(3)
    output = tmp_path / "0"
    stops = 0
    while True:
        try:
            sweep(
                output,
                executor=cut(5, 2, dice),
                threads=1 + stops % 2 % available_threads(),
            )
            break
        except Stop:
            stops += 1
        files = open_stored(output).files()
        if stops % 3 == 1:
            dice.choice(files).unlink()
        if stops % 3 == 2:
            dice.choice(files).write_bytes(b"PAR1")
            (output / "manifest.json").unlink()
        output = Path(shutil.move(output, tmp_path / str(stops)))
    assert stops > 4
    shutil.rmtree(output / "damaged")
    check_equal(output, whole)


def test_runs_that_failed_and_were_done_again(whole, tmp_path):
    failed = [RUNS]
    for steps in (1000, 3000):
        config = FULL | {"integrator": {"max_steps": steps}}
        result = sweep(tmp_path, config, retry_failed=True, executor=cut(7))
        assert result.done == failed[-1]
        failed.append(result.failed["step_limit"])
    assert RUNS > failed[1] > failed[2] > 0
    # Without the flag they count as done.
    assert sweep(tmp_path).done == 0
    result = sweep(tmp_path, retry_failed=True)
    assert (result.done, result.failed) == (failed[2], {})
    check_equal(tmp_path, whole)


def test_an_executor_that_loses_runs_is_found_out(tmp_path):
    def losing(work: Job, blocks: Iterator[Keys]) -> None:
        case, sample = next(blocks)
        local(work, iter([(case[1:], sample[1:])]))

    with pytest.raises(OutputError, match="left out 1 of the runs"):
        sweep(tmp_path, SMALL, executor=losing)
    assert not (tmp_path / "summary.parquet").exists()
    assert sweep(tmp_path, SMALL).done == 1


STEPS = {
    "samples too": (SMALL, changed(SMALL, spin=SPIN, bodies={"samples": 13})),
    "in samples, cases and targets": (
        AIMED,
        changed(
            AIMED,
            bodies={"samples": 40, "target": TARGET | {"K_r": [0.05, 0.1]}},
            spin=SPIN,
        ),
    ),
    "of a sequence": (
        changed(SMALL, bodies={"draw": "sobol"}),
        changed(SMALL, bodies={"draw": "sobol", "samples": 40}),
    ),
}


def by_key(directory: Path) -> Any:
    """All rows in the order of their launches, without the numbers of their cases."""
    stored = open_stored(directory)
    rows = stored.read()
    table = rows.to_pandas()
    table["target"] = np.array([case.target or 0.0 for case in stored.cases])[
        table.case
    ]
    order = ["target", "n_i", "omega_xy0", "sample"]
    return table.sort_values(order, ignore_index=True).drop(columns="case")


@pytest.mark.parametrize(("small", "more"), STEPS.values(), ids=STEPS)
def test_is_as_if_begun_with_more(small, more, tmp_path):
    sweep(tmp_path / "whole", more)
    grown = tmp_path / "grown"
    before = sweep(grown, small).runs
    cases = open_stored(grown).cases
    result = sweep(grown, more)
    assert result.done == result.runs - before
    assert open_stored(grown).cases[: len(cases)] == cases
    assert by_key(grown).equals(by_key(tmp_path / "whole"))


REFUSED = {
    "fewer samples": (changed(SMALL, bodies={"samples": 11}), "a sweep can only grow"),
    "a case less": (
        changed(SMALL, spin={"n_i": [-0.1, 0.3]}),
        "holds runs with n_i 0.2",
    ),
    "another seed too": (
        changed(LARGE, seed=1),
        "holds another sweep (seed: 0 against 1)",
    ),
    "another tolerance": (SMALL | {"integrator": {"tol": 1e-8}}, "integrator.tol: "),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_is_no_growth_is_refused(name, tmp_path):
    config, problem = REFUSED[name]
    sweep(tmp_path / "out", SMALL)
    shutil.copytree(tmp_path / "out", tmp_path / "before")
    for options in ({}, {"shard": Shard(0, 2)}):
        with pytest.raises(ConfigError) as refused:
            sweep(tmp_path / "out", config, **options)
        assert problem in refused.value.messages[0]
    assert sweeping.tree(tmp_path / "out") == sweeping.tree(tmp_path / "before")
    # Without the manifest, its rows are not taken for those of another sweep either.
    (tmp_path / "out" / "manifest.json").unlink()
    with pytest.raises((ConfigError, OutputError)):
        sweep(tmp_path / "out", config)
    assert not (tmp_path / "out" / "manifest.json").exists()
    assert sweep(tmp_path / "out", SMALL).done == 0
    check_equal(tmp_path / "out", tmp_path / "before")
