"""What blocks say of themselves, where the manifest is lost or files are not where they belong."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rattlesweep.errors import ConfigError, OutputError
from rattlesweep.sweeps.store.atomic import reason
from rattlesweep.sweeps.store.blockfile import Note, read_block_file
from rattlesweep.sweeps.tables.arrow import DamagedError

if TYPE_CHECKING:
    from pathlib import Path

    from rattlesweep.sweeps.cases.plan import Plan
    from rattlesweep.sweeps.store.store import Store


def block_size_of(store: Store, blocks: list[int], sweep: str, plan: Plan) -> int:
    """Runs a block in a directory whose manifest is lost.

    Parameters
    ----------
    blocks : list of int
        Numbers of those that are there.
    sweep : str
        Hash of the sweep that they must be of.

    Raises
    ------
    ConfigError
        They are not known to be of this sweep.
    """
    ours = False
    for index in blocks:
        note = _note(store.block_path(index))
        if note is None:
            continue
        if note.sweep != sweep:
            ours = False
            break
        ours = True
        size = note.first // index if index else note.stop
        # A block in the place of another says nothing of the size.
        if size > 0 and (note.first, note.stop) == (
            index * size,
            min((index + 1) * size, plan.runs),
        ):
            return max(size, plan.block_size) if size >= plan.runs else size
    if ours:
        return plan.block_size
    raise ConfigError(
        f"{store.directory}: it holds runs but no intact manifest.json, and the runs are not known "
        "to be of this config; choose another output, or start over with --fresh"
    )


def put_in_order(store: Store, plan: Plan, sweep: str) -> list[str]:
    """Take blocks of a sweep away from where none of them belongs, such as copied files.

    One whose own place is empty or damaged is put there.

    Parameters
    ----------
    sweep : str
        Hash of the sweep.

    Returns
    -------
    list of str
        What was done, and which other files readers will take for runs, a sentence each.
    """
    remarks = []
    try:
        for path in store.strays(plan.n_blocks):
            note = _note(path)
            if note is not None and note.sweep == sweep:
                index = note.first // plan.block_size
                block, place = plan.block(index), store.block_path(index)
                if (note.first, note.stop) != (block.first, block.stop):
                    path.unlink(missing_ok=True)
                    remarks.append(f"removed {path}: a block of another size than this sweep's")
                elif note.same_runs(_note(place)):
                    path.unlink(missing_ok=True)
                    remarks.append(f"removed {path}: a copy of {place.name}")
                else:
                    store.rename(path, place)
                    remarks.append(f"renamed {path} to {place.name}, whose runs it holds")
            elif store.is_block(path):
                raise OutputError(f"{path} is no block of this sweep; move it elsewhere")
            else:
                remarks.append(f"{path} is no block of this sweep, but readers take it for one")
    except OSError as error:
        raise OutputError(f"cannot use {store.runs}: {reason(error)}") from error
    return remarks


def _note(path: Path) -> Note | None:
    """What a file that holds a whole block says of itself."""
    try:
        file = read_block_file(path)
    except DamagedError:
        return None
    # With more or fewer rows than it speaks of, it is no block that is finished.
    note = file.note
    return note if note is not None and file.receipt.rows == note.stop - note.first else None
