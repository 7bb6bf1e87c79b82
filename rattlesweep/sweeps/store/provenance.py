"""What a directory says of its origin: config, versions, machine, times."""

from __future__ import annotations

import hashlib
import os
import platform
import sys
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rattlesweep.errors import ConfigError, DamagedManifest
from rattlesweep.sweeps.config.bodies import TableSource
from rattlesweep.sweeps.config.load import physics_hash, resolved
from rattlesweep.sweeps.store.manifest import FORMAT, check

if TYPE_CHECKING:
    from rattlesweep.sweeps.cases.plan import Plan
    from rattlesweep.sweeps.store.store import Store

PACKAGES = ("numpy", "numba", "llvmlite", "scipy", "pandas", "pyarrow")


def package_version() -> str:
    """Version of rattlesweep."""
    try:
        return version("rattlesweep")
    except PackageNotFoundError:
        return "unknown"


def now() -> str:
    """The time, in UTC."""
    return datetime.now(UTC).isoformat(timespec="seconds")


def command_line() -> list[str]:
    """The words of the command that this process is."""
    return [Path(sys.argv[0]).name, *sys.argv[1:]]


def machine() -> dict[str, Any]:
    """Processor, system and the processors that this process may use."""
    from llvmlite import binding

    allowed = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return {
        "system": platform.system(),
        "machine": platform.machine(),
        "cpu": binding.get_host_cpu_name(),
        "processors": allowed,
    }


def identity(plan: Plan, base: Path | None = None) -> str:
    """Hash of what determines the stored numbers: config, and the contents of a table."""
    digest = hashlib.sha256(physics_hash(plan.config).encode())
    for file in table_files(plan, base):
        with open(file, "rb") as handle:
            digest.update(hashlib.file_digest(handle, "sha256").digest())
    return digest.hexdigest()


def table_files(plan: Plan, base: Path | None = None) -> list[Path]:
    """Files that bodies are read from; none where they come from no table."""
    if not isinstance(plan.config.bodies, TableSource):
        return []
    path = Path(plan.config.bodies.path)
    if not path.exists() and base is not None:
        path = base / path
    return sorted(path.rglob("*.parquet")) if path.is_dir() else [path]


def versions() -> dict[str, str]:
    """Versions of what the numbers depend on."""
    return {
        "rattlesweep": package_version(),
        "python": platform.python_version(),
        **{name: version(name) for name in PACKAGES},
    }


def new_manifest(plan: Plan, hash_: str, base: Path | None) -> dict[str, Any]:
    """The manifest of a sweep that begins; `base` is where its table's path starts."""
    return {
        "format": FORMAT,
        "name": plan.config.name,
        "state": "running",
        "config": resolved(plan.config) | {"block_size": plan.block_size},
        "config_hash": hash_,
        "base": None if base is None else str(base),
        "cases": [
            {
                "case": case.index,
                **({case.target_name: case.target} if case.target_name else {}),
                "n_i": case.n_i,
                "omega_xy0": case.omega_xy0,
            }
            for case in plan.cases
        ],
        "samples": plan.samples,
        "runs": plan.runs,
        "blocks": plan.n_blocks,
        "versions": versions(),
        "machine": machine(),
        "started": now(),
        "command": command_line(),
        "failed": {},
        "sessions": [],
        "receipts": {},
    }


def read_manifest(store: Store) -> dict[str, Any]:
    """The manifest of a sweep; as :meth:`Store.read_manifest`, checked part by part.

    Raises
    ------
    ConfigError
        There is none, or it is of another format.
    DamagedManifest
        It is not what was written, or says what cannot be.
    """
    data = store.read_manifest()
    if isinstance(data.get("format"), int) and data["format"] != FORMAT:
        raise ConfigError(
            f"{store.directory}: it was written in format {data['format']}; this version writes "
            f"format {FORMAT}, so choose another output or start over with --fresh"
        )
    try:
        manifest = check(data)
    except ValueError as error:
        raise DamagedManifest(f"{store.manifest_path} is damaged: {error}") from None
    store.rows = manifest.config.block_size
    # With what an older version did not know of, at its default.
    return data | {"config": resolved(manifest.config)}
