"""A sweep with more samples or cases goes on from the runs of a smaller one in its directory.

The runs that are there get their numbers in the larger sweep and are cut into its blocks, as far as
they fill them; what is missing of a block is then done as after a stop. The new blocks are made in
a hidden folder, the manifest says in one step that the sweep is the larger one, and their folder
takes the place of the old: at any moment there is all of the one or of the other, and whoever
comes after a killed process begins anew or ends what was begun.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa

from rattlesweep.arrays import Integers
from rattlesweep.sweeps.config.bodies import TableSource
from rattlesweep.sweeps.config.load import differences, physics_part, resolved
from rattlesweep.sweeps.files import explained, rename_file
from rattlesweep.sweeps.old.blockfile import Note
from rattlesweep.sweeps.old.manifest import Manifest, StoredCase, targets_of
from rattlesweep.sweeps.old.store import Store
from rattlesweep.sweeps.types import with_types

if TYPE_CHECKING:
    from rattlesweep.sweeps.plan import Case, Plan

FOLDER = ".growing"


def growth(manifest: Manifest, plan: Plan) -> tuple[Integers | None, str]:
    """How a directory's sweep grows into that of a plan; and what differs, in words.

    That is the number that each of its cases has in the plan, ascending; None if it does not grow.
    """
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
    if targets_of(plan.config)[: len(before := targets_of(manifest.config))] != before:
        return None, f"{what}; new targets go behind those that are there"
    if np.any(np.diff(cases) <= 0):
        return None, f"{what}; new values may stand between the old ones, which keep their order"
    if (limit := manifest.config.integrator.max_steps) > plan.config.integrator.max_steps:
        return None, f"{what}; integrator.max_steps {limit} may only grow, too"
    return np.array(cases), what


def _fixed(part: dict[str, Any]) -> dict[str, Any]:
    """What of a config cannot change while its sweep grows."""
    bodies, spin = dict(part["bodies"]), part.get("spin")
    bodies.pop("samples", None)
    if (target := bodies.get("target")) is not None:
        values = {name: [] if name in ("K_r", "K_p") else value for name, value in target.items()}
        bodies["target"] = values
    spin = None if spin is None else spin | {"n_i": [], "omega_xy0": []}
    # By what they lose at all runs have their kernel.
    losses = part["dissipation"]
    losses = losses | {"sigma": [] if losses["sigma"] else 0.0}
    return part | {"bodies": bodies, "spin": spin, "dissipation": losses}


def _key(case: Case | StoredCase) -> tuple[Any, ...]:
    return case.target_name, case.target, case.n_i, case.omega_xy0, case.sigma, case.rolling


def grow(store: Store, smaller: Manifest, plan: Plan, hash_: str, cases: Integers) -> None:
    """Make the directory one of the larger sweep; it is held, and by nobody else.

    `cases` are as `growth` says.
    """
    remove_growth(store)
    new = Store(store.directory / FOLDER)
    new.prepare()
    # What is known of new blocks: rows, and the limit of steps under which they were done.
    known: dict[int, list[tuple[pa.Table, int]]] = {}

    def write(below: float) -> None:
        for index in [index for index in known if index < below]:
            block, (parts, limits) = plan.block(index), zip(*known.pop(index), strict=True)
            note = Note.of(plan.config, hash_, (block.first, block.stop))
            rows = with_types(pa.concat_tables(parts), plan.config.classify)
            new.write_block(index, rows, replace(note, max_steps=min(limits)))

    for index in range(smaller.blocks):
        # What is damaged will be computed again.
        file = store.find_block(index, (smaller.config_hash, *smaller.borders(index)))
        if file is None or file.note is None:
            continue
        rows = file.table()
        case = cases[rows.column("case").to_numpy()]
        blocks = (case * plan.samples + rows.column("sample").to_numpy()) // plan.block_size
        place = rows.schema.get_field_index("case")
        rows = rows.set_column(place, rows.schema.field(place), pa.array(case, pa.int32()))
        for block in np.unique(blocks).tolist():
            write(block)  # numbers ascend, so that what comes before is complete
            part = rows.filter(pa.array(blocks == block))
            known.setdefault(block, []).append((part, file.note.max_steps))
    write(np.inf)
    larger = Manifest.begin(plan, hash_, None)

    def change(manifest: Manifest) -> None:
        for name in ("name", "state", "config", "config_hash", "cases", "samples", "runs",
                     "blocks", "receipts"):  # fmt: skip
            setattr(manifest, name, getattr(larger, name))
        manifest.expected = manifest.finished = None
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
    Store(store.directory).update_manifest(lambda manifest: setattr(manifest, "growing", None))


def remove_growth(store: Store) -> None:
    """Remove what is left of a growth."""
    folder = store.directory / FOLDER
    with explained(f"cannot remove {folder}"):
        for path in sorted(folder.rglob("*"), reverse=True):
            path.rmdir() if path.is_dir() else path.unlink()
        if folder.exists():
            folder.rmdir()
