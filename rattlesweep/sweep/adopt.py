"""What blocks say of themselves, where the manifest is lost or files are not where they belong."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

from rattlesweep.sweep.errors import ConfigError, OutputError
from rattlesweep.sweep.files import reason
from rattlesweep.sweep.store import Store, inspect_file
from rattlesweep.sweep.tables import DamagedError

if TYPE_CHECKING:
    from pathlib import Path

    from rattlesweep.sweep.plan import Plan
    from rattlesweep.sweep.receipts import Note


def adopted_size(store: Store, blocks: list[int], sweep: str, plan: Plan) -> int:
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


def remove_copies(store: Store, blocks: int, sweep: str) -> list[str]:
    """Remove blocks of a sweep from where none of them belongs, such as copied files.

    Parameters
    ----------
    blocks : int
        How many the sweep has.
    sweep : str
        Its hash.

    Returns
    -------
    list of str
        What was removed, and which other files readers will take for runs, a sentence each.

    Raises
    ------
    OutputError
        A file has the name of a block but is none of this sweep, or cannot be read or removed.
    """
    wanted = {store.block_path(index).name for index in range(blocks)}
    remarks = []
    try:
        for path in sorted(store.runs / name for name in os.listdir(store.runs)):
            if path.name in wanted or path.name.startswith(".") or path.suffix != ".parquet":
                continue
            note = _note(path)
            if note is not None and note.sweep == sweep:
                path.unlink(missing_ok=True)
                remarks.append(f"removed {path}: a copy of a block")
            elif store.is_block(path):
                raise OutputError(f"{path} is no block of this sweep; move it elsewhere")
            else:
                remarks.append(f"{path} is no block of this sweep, but readers take it for one")
    except OSError as error:
        raise OutputError(f"cannot use {store.runs}: {reason(error)}") from error
    return remarks


def _note(path: Path) -> Note | None:
    """What a whole file says of itself."""
    try:
        return inspect_file(path).note
    except DamagedError:
        return None
