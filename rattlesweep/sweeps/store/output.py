"""What an output directory is to a plan, before anything is written there."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rattlesweep.errors import ConfigError, DamagedManifest
from rattlesweep.sweeps.config.load import differences, physics_part, resolved
from rattlesweep.sweeps.store.blockfile import Note
from rattlesweep.sweeps.store.manifest import Manifest
from rattlesweep.sweeps.store.provenance import identity, machine, versions
from rattlesweep.sweeps.store.recover import block_size_of
from rattlesweep.sweeps.store.store import Store

if TYPE_CHECKING:
    from rattlesweep.sweeps.cases.plan import Block, Plan


@dataclass(frozen=True)
class Output:
    """Where the blocks of a plan come to rest.

    Attributes
    ----------
    plan : Plan
        In the blocks that the directory was begun with.
    hash_ : str
        Of what determines its numbers.
    manifest : Manifest or None
        None where the sweep begins, or its manifest is lost.
    remarks : list of str
        What the user should know: versions that have changed, a lost manifest.
    retry_failed : bool
        Whether runs that failed are to be done again.
    """

    store: Store
    plan: Plan
    hash_: str
    manifest: Manifest | None
    remarks: list[str]
    retry_failed: bool = False

    def note(self, block: Block) -> Note:
        """What a block of this plan says of itself."""
        config = self.plan.config
        thresholds = resolved(config)["classify"]
        return Note(self.hash_, block.first, block.stop, thresholds, config.integrator.max_steps)


def examine(plan: Plan, directory: Path, base: Path | None) -> Output:
    """Compare a directory with a plan; nothing is written.

    Raises
    ------
    ConfigError
        If the directory holds the runs of another config; says what differs.
    OutputError
        If it cannot be read.
    """
    store, hash_ = Store(directory), identity(plan, base)
    store.check_ours()
    blocks = store.block_indices()
    remarks: list[str] = []
    manifest: Manifest | None = None
    try:
        if store.has_manifest():
            manifest = store.read_manifest()
    except DamagedManifest as error:
        remarks.append(f"{error}; it is rebuilt from the blocks")
    if manifest is None:
        if blocks:
            plan = replace(plan, block_size=block_size_of(store, blocks, hash_, plan))
        return Output(store, plan, hash_, None, remarks)
    theirs, ours = resolved(manifest.config), resolved(plan.config)
    if manifest.config_hash != hash_:
        changes = differences(physics_part(theirs), physics_part(ours))
        what = "; ".join(changes[:3]) or "the table of bodies has changed"
        raise ConfigError(
            f"{directory}: it holds the runs of another config ({what}); choose another output, or "
            "start over with --fresh"
        )
    size = manifest.config.block_size
    if size != plan.block_size:
        remarks.append(f"{directory} was begun in blocks of {size} runs, and keeps that size")
        plan = replace(plan, block_size=size)
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
        if changed := differences(_of_bits(then), _of_bits(today)):
            remarks.append(
                f"{directory} was begun with other {part} ({'; '.join(changed[:3])}): last bits "
                "may differ"
            )
    return Output(store, plan, hash_, manifest, remarks)


def _of_bits(part: dict[str, Any]) -> dict[str, Any]:
    """What of a part of the manifest the last bits may depend on: not on the processors' number."""
    return {key: value for key, value in part.items() if key != "processors"}
