"""What an output directory is to a plan: whose runs it holds, and which files are in the way.

And how a process takes hold of it, and makes it one of the sweep that is to go on there.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rattlesweep.arrays import Integers
from rattlesweep.errors import ConfigError, DamagedError, OutputError
from rattlesweep.sweeps.config.load import differences, resolved
from rattlesweep.sweeps.files import explained
from rattlesweep.sweeps.old.blockfile import Note, block_number, read_block_file
from rattlesweep.sweeps.old.growth import finish_growth, grow, growth, remove_growth
from rattlesweep.sweeps.old.locks import hold
from rattlesweep.sweeps.old.manifest import Manifest, Receipt
from rattlesweep.sweeps.provenance import identity, machine, table_files, versions
from rattlesweep.sweeps.old.store import Store
from rattlesweep.sweeps.old.stored import Staged

if TYPE_CHECKING:
    from rattlesweep.sweeps.plan import Block, Plan


@dataclass(frozen=True)
class Output:
    """Where the blocks of a plan come to rest."""

    store: Store
    plan: Plan  # in the blocks that the directory was begun with
    base: Path | None  # where the relative path of its table of bodies starts
    hash_: str  # of what determines its numbers
    manifest: Manifest | None = None  # None where the sweep begins, or its manifest is lost
    remarks: list[str] = field(default_factory=list)  # what the user should know of the directory
    retry_failed: bool = False  # whether runs that failed are to be done again
    # Numbers here of the cases of a smaller sweep, which the directory holds.
    growth: Integers | None = None
    staged: Staged | None = None  # what it has decided to run so far, once it is held

    def note(self, block: Block) -> Note:
        """What a block of this plan says of itself."""
        return Note.of(self.plan.config, self.hash_, (block.first, block.stop))

    def finished(self, block: Block) -> Receipt | None:
        """The receipt of a block that is in place, whole and as this session would write it."""
        return self.store.finished_block(block.index, self.note(block))


@contextmanager
def open_output(
    plan: Plan,
    directory: Path,
    base: Path | None,
    *,
    share: str | None = None,
    fresh: bool = False,
    retry_failed: bool = False,
) -> Iterator[Output]:
    """Hold a directory, or a share of it, for a plan; first remove its runs if `fresh`."""
    if not fresh:
        examine(plan, directory, base)  # before anything is made there
    store = Store(directory)
    store.prepare()
    with hold(directory, share) as alone:
        if fresh:
            _start_over(store, plan, base)
        store.remove_stale_temporaries(alone)
        output = _grown(examine(plan, directory, base), share)
        plan = output.plan
        if plan.stages and retry_failed:
            raise ConfigError(
                f"--retry-failed: {plan.stages_by} has chosen the runs by what came out, "
                "failed ones too; repeat them in another output"
            )
        staged = Staged(store, plan.config, len(plan.cases), plan.samples, output.hash_)
        output = replace(output, plan=staged.of(plan), staged=staged, retry_failed=retry_failed)
        output.remarks.extend(put_in_order(output))
        yield output


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


def _grown(output: Output, share: str | None) -> Output:
    """What a directory that is held is once it is one of the plan's sweep."""
    store, manifest = output.store, output.manifest
    half = manifest is not None and bool(manifest.growing)
    if share is not None:
        if half or output.growth is not None:
            raise ConfigError(
                f"{store.directory}: holds fewer samples or cases, and a share cannot add to them; "
                "run it without --shard, or merge the shares and do so there"
            )
        return output
    (finish_growth if half else remove_growth)(store)
    if manifest is not None and output.growth is not None:
        grow(store, manifest, output.plan, output.hash_, output.growth)
    elif not half:
        return output
    again = examine(output.plan, store.directory, output.base)
    return replace(again, remarks=output.remarks)


def examine(plan: Plan, directory: Path, base: Path | None) -> Output:
    """Compare a directory with a plan; nothing is written.

    If it holds the runs of another config, a ConfigError says what differs.
    """
    store, hash_ = Store(directory), identity(plan, base)
    store.check_ours()
    remarks: list[str] = []
    manifest: Manifest | None = None
    try:
        if store.has_manifest():
            manifest = store.read_manifest()
    except DamagedError as error:
        remarks.append(f"{error}; it is rebuilt from the blocks")
    if manifest is None:
        if not plan.stages and (blocks := store.block_indices()):
            plan = _in_blocks(plan, _block_size(store, blocks, hash_, plan))
        return Output(store, plan, base, hash_, None, remarks)
    theirs, ours = resolved(manifest.config), resolved(plan.config)
    cases: Integers | None = None
    if manifest.config_hash != hash_:
        cases, what = growth(manifest, plan)
        if cases is None:
            raise ConfigError(
                f"{directory}: it holds the runs of another config ({what}); choose another "
                "output, or start over with --fresh"
            )
        remarks.append(
            f"{directory} goes on from {manifest.runs} to {plan.runs} runs; those that are there "
            "are kept"
        )
    # One begun before tables brought columns along goes on without them.
    plan = replace(plan, extra=manifest.extra)
    size = manifest.config.block_size
    if size != plan.block_size:
        remarks.append(f"{directory} was begun in blocks of {size} runs, and keeps that size")
        plan = _in_blocks(plan, size)
    if changed := differences(theirs["classify"], ours["classify"]):
        by = "`rattlesweep classify`" if manifest.classified else "an earlier config"
        remarks.append(
            f"{directory} had types by the thresholds of {by}, and has those of this config now "
            f"(classify.{', classify.'.join(changed)})"
        )
    for part, then, today in (
        ("versions", manifest.versions, versions()),
        ("machine", manifest.machine, machine()),
    ):
        # What directories of before do not tell is not known to differ.
        known = {key: value for key, value in today.items() if key in then}
        if changed := differences(_of_bits(then), _of_bits(known)):
            remarks.append(
                f"{directory} was begun with other {part} ({'; '.join(changed[:3])}): last bits "
                "may differ"
            )
    return Output(store, plan, base, hash_, manifest, remarks, growth=cases)


def put_in_order(output: Output) -> list[str]:
    """Take blocks of a sweep away from where none of them belongs, such as copied files.

    One whose own place is empty or damaged is put there. Returns sentences: what was done, and
    which other files readers will take for runs.
    """
    store, plan, remarks = output.store, output.plan, []
    for path in store.strays(plan.n_blocks):
        note = _note(path)
        if plan.stages and note and note.sweep == output.hash_ and block_number(path.name):
            continue  # of a stage that is not known again yet
        if note is None or note.sweep != output.hash_:
            if block_number(path.name) is not None:
                raise OutputError(f"{path} is no block of this sweep; move it elsewhere")
            remarks.append(f"{path} is no block of this sweep, but readers take it for one")
            continue
        block = plan.block(plan.block_of(note.first))
        place = store.block_path(block.index)
        with explained(f"cannot use {store.runs}"):
            if (note.first, note.stop) != (block.first, block.stop):
                path.unlink(missing_ok=True)
                remarks.append(f"removed {path}: a block of another size than this sweep's")
            elif (there := _note(place)) is not None and there.runs == note.runs:
                path.unlink(missing_ok=True)
                remarks.append(f"removed {path}: a copy of {place.name}")
            else:
                store.put_in_place(path, block.index)
                remarks.append(f"renamed {path} to {place.name}, whose runs it holds")
    return remarks


def _in_blocks(plan: Plan, size: int) -> Plan:
    return replace(plan, config=plan.config.model_copy(update={"block_size": size}))


def _block_size(store: Store, blocks: list[int], sweep: str, plan: Plan) -> int:
    """Runs a block in a directory whose manifest is lost, told from the blocks.

    A ConfigError if they are not known to be of this sweep.
    """
    size = 0
    for index in blocks:
        note = _note(store.block_path(index))
        if note is None:
            continue
        if note.sweep != sweep:
            size = 0
            break
        if note.stop < plan.runs:
            return note.stop - note.first
        # The last one may be smaller, and is the only one of a size beyond the runs.
        size = note.first // index if index and note.first else max(note.stop, plan.block_size)
    if size:
        return size
    raise ConfigError(
        f"{store.directory}: it holds runs but no intact manifest.json, and the runs are not known "
        "to be of this config; choose another output, or start over with --fresh"
    )


def _note(path: Path) -> Note | None:
    """What a file that holds a whole block says of itself."""
    try:
        file = read_block_file(path)
    except DamagedError:
        return None
    # With more or fewer rows than it speaks of, it is no block that is finished.
    note = file.note
    return note if note is not None and file.receipt.rows == note.stop - note.first else None


def _of_bits(part: dict[str, Any]) -> dict[str, Any]:
    """What of a part of the manifest the last bits may depend on: not on the processors' number."""
    return {key: value for key, value in part.items() if key != "processors"}
