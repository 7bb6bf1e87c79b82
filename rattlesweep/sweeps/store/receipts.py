"""What a block says of itself, and what the manifest says of a block."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field
from typing import Any


def borders(manifest: Mapping[str, Any], index: int) -> tuple[int, int]:
    """Numbers of the runs of block `index` in a directory with this manifest, from and up to."""
    size: int = manifest["config"]["block_size"]
    return index * size, min((index + 1) * size, manifest["runs"])


def count_failed(receipts: Iterable[Any]) -> dict[str, int]:
    """Runs by status, other than ``ok``, of blocks by their receipts in a manifest."""
    failed: Counter[str] = Counter()
    for receipt in receipts:
        failed.update(receipt.get("failed", {}))
    return dict(sorted(failed.items()))


@dataclass(frozen=True)
class Note:
    """Written into a block's file: which runs of which sweep it holds.

    Attributes
    ----------
    sweep : str
        Hash of what determines the numbers (`provenance.identity`).
    first, stop : int
        Numbers of its runs, ``first <= run < stop``.
    classify : dict
        Thresholds behind its types.
    max_steps : int
        Limit under which its runs were done.
    """

    sweep: str
    first: int
    stop: int
    classify: dict[str, float]
    max_steps: int

    def dump(self) -> bytes:
        """As text for a file's metadata."""
        return json.dumps(asdict(self), sort_keys=True).encode()

    @classmethod
    def load(cls, text: bytes | None) -> Note | None:
        """From a file's metadata; None if there is none that makes sense."""
        try:
            return cls(**json.loads(text or b""))
        except (ValueError, TypeError):
            return None

    @classmethod
    def of(cls, manifest: Mapping[str, Any], index: int) -> Note:
        """What block `index` of a directory with this manifest has to say."""
        config = manifest["config"]
        limit = config["integrator"]["max_steps"]
        return cls(manifest["config_hash"], *borders(manifest, index), config["classify"], limit)

    def same_runs(self, other: Note | None) -> bool:
        """Whether another block is to hold the same numbers, types and limit aside."""
        return other is not None and (self.sweep, self.first, self.stop) == (
            other.sweep,
            other.first,
            other.stop,
        )


@dataclass(frozen=True)
class Receipt:
    """What the manifest keeps of a block.

    Attributes
    ----------
    sha256 : str
        Of the file's bytes, in hexadecimal.
    rows, bytes : int
    failed : dict
        Number of runs by status, other than ``ok``.
    seconds : float or None
        Time of its integration; None where that is not known.
    """

    sha256: str
    rows: int
    bytes: int
    failed: dict[str, int] = field(default_factory=dict)
    seconds: float | None = None

    def dump(self) -> dict[str, Any]:
        """As plain data, without what is empty."""
        return {key: value for key, value in asdict(self).items() if value not in ({}, None)}

    @classmethod
    def load(cls, data: Any) -> Receipt | None:
        """From plain data; None if it makes no sense."""
        try:
            return cls(**data)
        except TypeError:
            return None
