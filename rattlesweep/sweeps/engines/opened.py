"""What an output directory is to a plan, before anything is written there."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rattlesweep.errors import ConfigError, DamagedManifest
from rattlesweep.sweeps.config.load import differences, physics_part, resolved
from rattlesweep.sweeps.store.provenance import identity, new_manifest, read_manifest
from rattlesweep.sweeps.store.receipts import Note
from rattlesweep.sweeps.store.recover import adopted_size
from rattlesweep.sweeps.store.store import Store

if TYPE_CHECKING:
    from rattlesweep.sweeps.cases.plan import Block, Plan


@dataclass(frozen=True)
class Opened:
    """What a directory is to a plan.

    Attributes
    ----------
    plan : Plan
        In the blocks that the directory was begun with.
    manifest : dict or None
        None where the sweep begins, or its manifest is lost.
    remarks : list of str
        What the user should know: versions that have changed, a lost manifest.
    retry_failed : bool
        Whether runs that failed are to be done again.
    """

    store: Store
    plan: Plan
    hash_: str
    manifest: dict[str, Any] | None
    remarks: list[str]
    retry_failed: bool = False

    def note(self, block: Block) -> Note:
        """What a block of this plan says of itself."""
        config = self.plan.config
        thresholds = resolved(config)["classify"]
        return Note(self.hash_, block.first, block.stop, thresholds, config.integrator.max_steps)


def examine(plan: Plan, directory: Path, base: Path | None) -> Opened:
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
    manifest: dict[str, Any] | None = None
    try:
        if store.has_manifest():
            manifest = read_manifest(store)
    except DamagedManifest as error:
        remarks.append(f"{error}; it is rebuilt from the blocks")
    if manifest is None:
        if blocks:
            plan = replace(plan, block_size=adopted_size(store, blocks, hash_, plan))
        return Opened(store, plan, hash_, None, remarks)
    if manifest.get("config_hash") != hash_:
        ours = resolved(plan.config)
        changes = differences(physics_part(manifest["config"]), physics_part(ours))
        what = "; ".join(changes[:3]) or "the table of bodies has changed"
        raise ConfigError(
            f"{directory}: it holds the runs of another config ({what}); choose another output, or "
            "start over with --fresh"
        )
    size = manifest["config"]["block_size"]
    if size != plan.block_size:
        remarks.append(f"{directory} was begun in blocks of {size} runs, and keeps that size")
        plan = replace(plan, block_size=size)
    if changed := differences(manifest["config"]["classify"], resolved(plan.config)["classify"]):
        by = "`rattlesweep classify`" if "classified" in manifest else "an earlier config"
        remarks.append(
            f"{directory} had types by the thresholds of {by}, and has those of this config now "
            f"(classify.{', classify.'.join(changed)})"
        )
    current = new_manifest(plan, hash_, base)
    for part in ("versions", "machine"):
        if changed := differences(_of_bits(manifest[part]), _of_bits(current[part])):
            remarks.append(
                f"{directory} was begun with other {part} ({'; '.join(changed[:3])}): last bits "
                "may differ"
            )
    return Opened(store, plan, hash_, manifest, remarks)


def _of_bits(part: dict[str, Any]) -> dict[str, Any]:
    """What of a part of the manifest the last bits may depend on: not on the processors' number."""
    return {key: value for key, value in part.items() if key != "processors"}


__all__ = ["Opened", "examine"]
