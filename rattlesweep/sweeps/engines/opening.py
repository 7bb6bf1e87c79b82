"""Take hold of an output directory, and make it one of the sweep that is to go on there."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

from rattlesweep.errors import ConfigError
from rattlesweep.sweeps.cases.costs import Costs
from rattlesweep.sweeps.cases.plan import Plan
from rattlesweep.sweeps.cases.shards import Shard, deal
from rattlesweep.sweeps.engines.session import Session
from rattlesweep.sweeps.store.atomic import explained
from rattlesweep.sweeps.store.growth import finish_growth, grow, remove_growth
from rattlesweep.sweeps.store.locks import hold
from rattlesweep.sweeps.store.output import Output, examine, put_in_order
from rattlesweep.sweeps.store.provenance import table_files
from rattlesweep.sweeps.store.store import Store
from rattlesweep.sweeps.store.stored import follow_stages


@contextmanager
def open_session(
    plan: Plan,
    directory: Path,
    base: Path | None,
    threads: int,
    *,
    shard: Shard | None = None,
    fresh: bool = False,
    retry_failed: bool = False,
) -> Iterator[Session]:
    """Take hold of a directory, or of a share of it; first remove its runs if `fresh`."""
    if not fresh:
        examine(plan, directory, base)  # before anything is made there
    store = Store(directory)
    store.prepare()
    with hold(directory, None if shard is None else shard.name) as alone:
        if fresh:
            _start_over(store, plan, base)
        store.remove_stale_temporaries(alone)
        output = examine(plan, directory, base)
        half = output.manifest is not None and bool(output.manifest.growing)
        if shard is None:
            output = _grown(output, half)
        elif half or output.growth is not None:
            raise ConfigError(
                f"{directory}: holds fewer samples or cases, and a share cannot add to them; run "
                "it without --shard, or merge the shares and do so there"
            )
        plan = output.plan
        if plan.stages and retry_failed:
            raise ConfigError(
                f"--retry-failed: {plan.stages_by} has chosen the runs by what came out, "
                "failed ones too; repeat them in another output"
            )
        staged = follow_stages(store, plan, output.hash_)
        plan = plan if staged is None else staged.of(plan)
        output = replace(output, plan=plan, retry_failed=retry_failed)
        output.remarks.extend(put_in_order(output))
        costs = Costs(plan)
        shares = deal(plan, 1 if shard is None else shard.count, costs)
        blocks = shares[0 if shard is None else shard.index]
        yield Session(output, shard, threads, costs, blocks, staged)


def _grown(output: Output, half: bool) -> Output:
    """What the directory is once it is one of this sweep; `half`: one has begun to make it so."""
    if half:
        finish_growth(output.store)
    else:
        remove_growth(output.store)
    if output.growth is not None and output.manifest is not None:
        grow(output.store, output.manifest, output.plan, output.hash_, output.growth)
    elif not half:
        return output
    again = examine(output.plan, output.store.directory, output.base)
    return replace(again, remarks=output.remarks)


def _start_over(store: Store, plan: Plan, base: Path | None) -> None:
    """Remove the files of a sweep, and only those; not what this one is to begin from."""
    # The manifest first: without it, what is left is nobody's.
    blocks = map(store.block_path, store.block_indices())
    files = [store.manifest_path, store.summary_path, *blocks]
    removed = {path.resolve() for path in files}
    for path in table_files(plan, base):
        if path.resolve() in removed:
            raise ConfigError(
                f"--fresh: would remove {path}, which this sweep takes its bodies from; choose "
                "another output"
            )
    with explained(f"cannot remove the runs in {store.directory}"):
        for path in files:
            path.unlink(missing_ok=True)
