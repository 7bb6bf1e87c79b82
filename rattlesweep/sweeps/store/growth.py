"""A sweep with more samples or cases goes on from the runs of a smaller one in its directory.

The runs that are there get their numbers in the larger sweep and are cut into its blocks, as far as
they fill them; what is missing of a block is then done as after a stop. The new blocks are made in
a hidden folder, the manifest says in one step that the sweep is the larger one, and their folder
takes the place of the old: at any moment there is all of the one or of the other, and whoever
comes after a killed process begins anew or ends what was begun.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa

from rattlesweep.sweeps.cases.stages import borders
from rattlesweep.sweeps.config.bodies import SdSource, TableSource
from rattlesweep.sweeps.config.load import differences, physics_part, resolved
from rattlesweep.sweeps.store.atomic import explained, rename_file
from rattlesweep.sweeps.store.blockfile import Note
from rattlesweep.sweeps.store.manifest import Manifest
from rattlesweep.sweeps.store.store import Store
from rattlesweep.sweeps.tables.types import with_types

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from rattlesweep.sweeps.cases.plan import Case, Plan
    from rattlesweep.sweeps.config.schema import Config
    from rattlesweep.sweeps.store.blockfile import BlockFile
    from rattlesweep.sweeps.store.manifest import StoredCase

FOLDER = ".growing"


@dataclass(frozen=True)
class Growth:
    """Where the runs of a smaller sweep are in a larger one."""

    sweep: str  # hash of the smaller one, which its blocks have
    old: int  # samples of each case of the smaller one
    new: int  # and of the larger one
    cases: NDArray[np.int64]  # number there of each case of the smaller one, ascending

    def before(self, number: int) -> int:
        """How many runs of the smaller sweep come before a number of the larger one."""
        case, sample = divmod(number, self.new)
        whole = int(np.searchsorted(self.cases, case))
        here = whole < len(self.cases) and self.cases[whole] == case
        return whole * self.old + (min(sample, self.old) if here else 0)

    def runs(self, index: int, size: int) -> tuple[str, int, int]:
        """The runs of a block of the smaller one (`Note.runs`)."""
        return self.sweep, *borders([len(self.cases) * self.old], size, index)

    @property
    def end(self) -> int:
        """Number in the larger sweep behind the last run of the smaller one."""
        return int(self.cases[-1]) * self.new + self.old


def growth(manifest: Manifest, plan: Plan, hash_: str) -> tuple[Growth | None, str]:
    """How a directory's sweep grows into that of a plan, or None; and what differs, in words."""
    theirs, ours = physics_part(resolved(manifest.config)), physics_part(resolved(plan.config))
    what = "; ".join(differences(theirs, ours)[:3]) or "the table of bodies has changed"
    if differences(_fixed(theirs), _fixed(ours)) or isinstance(plan.config.bodies, TableSource):
        return None, what
    if plan.stages:
        return None, f"{what}; a sweep that decides what to run does not grow"
    if plan.samples < manifest.samples:
        return None, f"{what}; there can be more samples, but not fewer"
    places = {_key(case): case.index for case in plan.cases}
    cases = [places.get(_key(case), -1) for case in manifest.cases]
    if min(cases) < 0:
        return None, f"{what}; there can be more cases, but none can go"
    # Draws depend on the place of a target in its list.
    if _targets(plan.config)[: len(before := _targets(manifest.config))] != before:
        return None, f"{what}; new targets go behind those that are there"
    if np.any(np.diff(cases) <= 0):
        return None, f"{what}; new values may stand between the old ones, which keep their order"
    if (limit := manifest.config.integrator.max_steps) > plan.config.integrator.max_steps:
        return None, f"{what}; integrator.max_steps {limit} may only grow, too"
    return Growth(manifest.config_hash, manifest.samples, plan.samples, np.array(cases)), what


def _fixed(part: dict[str, Any]) -> dict[str, Any]:
    """What of a config cannot change while its sweep grows."""
    bodies, spin = dict(part["bodies"]), part.get("spin")
    bodies.pop("samples", None)
    if (target := bodies.get("target")) is not None:
        values = {name: [] if name in ("K_r", "K_p") else value for name, value in target.items()}
        bodies["target"] = values
    spin = None if spin is None else spin | {"n_i": [], "omega_xy0": []}
    return part | {"bodies": bodies, "spin": spin}


def _key(case: Case | StoredCase) -> tuple[Any, ...]:
    return case.target_name, case.target, case.n_i, case.omega_xy0


def _targets(config: Config) -> Sequence[float]:
    target = config.bodies.target if isinstance(config.bodies, SdSource) else None
    return [] if target is None else target.values


def grow(store: Store, plan: Plan, hash_: str, growth: Growth) -> None:
    """Make the directory one of the larger sweep; it is held, and by nobody else."""
    remove_growth(store)
    new = Store(store.directory / FOLDER)
    new.prepare()
    size = plan.block_size
    # An old block is read once, though several new ones may take of it; what is damaged will be
    # computed again.
    read: dict[int, BlockFile | None] = {}
    for index in range(-(-growth.end // size)):
        block = plan.block(index)
        first, stop = growth.before(block.first), growth.before(block.stop)
        wanted = range(first // size, -(-stop // size)) if stop > first else range(0)
        read = {
            i: read[i] if i in read else store.find_block(i, growth.runs(i, size)) for i in wanted
        }
        files = [file for file in read.values() if file is not None]
        parts = [_renumbered(file.table(), growth, block.first, block.stop) for file in files]
        if any(len(part) for part in parts):
            note = Note.of(plan.config, hash_, (block.first, block.stop))
            limit = min(file.note.max_steps for file in files if file.note)
            rows = with_types(pa.concat_tables(parts), plan.config.classify)
            new.write_block(index, rows, replace(note, max_steps=limit))
    larger = Manifest.begin(plan, hash_, None)

    def change(manifest: Manifest) -> None:
        for name in ("name", "state", "config", "config_hash", "cases", "samples", "runs",
                     "blocks", "receipts"):  # fmt: skip
            setattr(manifest, name, getattr(larger, name))
        for name in ("expected", "finished"):
            manifest.clear(name)
        manifest.growing = True

    store.update_manifest(change)
    finish_growth(store)


def finish_growth(store: Store) -> None:
    """Let the new blocks take the place of the old, which the manifest has no more."""
    new, before = store.directory / FOLDER / "runs", store.directory / FOLDER / "before"
    with explained(f"cannot replace {store.runs}"):
        # Its cases may have other numbers now.
        store.summary_path.unlink(missing_ok=True)
        if new.exists():
            if before.exists():
                # Made by who came after the process that was killed between the two steps.
                store.runs.rmdir()
            else:
                rename_file(store.runs, before)
            rename_file(new, store.runs)
    remove_growth(store)
    Store(store.directory).update_manifest(lambda manifest: manifest.clear("growing"))


def remove_growth(store: Store) -> None:
    """Remove what is left of a growth."""
    folder = store.directory / FOLDER
    with explained(f"cannot remove {folder}"):
        for path in sorted(folder.rglob("*"), reverse=True):
            path.rmdir() if path.is_dir() else path.unlink()
        if folder.exists():
            folder.rmdir()


def _renumbered(rows: pa.Table, growth: Growth, first: int, stop: int) -> pa.Table:
    """Rows of the smaller sweep that are in a span of the larger one, by their cases there."""
    case = growth.cases[rows.column("case").to_numpy()]
    number = case * growth.new + rows.column("sample").to_numpy()
    place = rows.schema.get_field_index("case")
    rows = rows.set_column(place, rows.schema.field("case"), pa.array(case, pa.int32()))
    return rows.filter(pa.array((number >= first) & (number < stop)))
