"""Type stored runs again, without integrating."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pyarrow as pa
import pyarrow.compute as pc

from rattlesweep.sweep.config import override_config, resolved
from rattlesweep.sweep.errors import ConfigError
from rattlesweep.sweep.provenance import read_manifest
from rattlesweep.sweep.store import Store
from rattlesweep.sweep.summary import summarise
from rattlesweep.sweep.types import TYPES, classify

if TYPE_CHECKING:
    from collections.abc import Sequence

    import numpy as np
    from numpy.typing import NDArray

    from rattlesweep.sweep.config import Classify


def retype_blocks(store: Store, thresholds: Classify) -> int:
    """Give every stored run the type that these thresholds ask for.

    Parameters
    ----------
    store : Store
        Its blocks whose types change are replaced, one by one and each in one step.
    thresholds : Classify

    Returns
    -------
    int
        Number of runs whose type has changed.
    """
    changed = 0
    for index, table in store.iter_blocks():
        typed = _typed(table, thresholds)
        before = table.column("type").combine_chunks()
        differing = _differing(before, typed)
        if differing:
            place = table.schema.get_field_index("type")
            store.rewrite_block(index, table.set_column(place, table.schema.field(place), typed))
            changed += differing
    return changed


def retype(directory: Path, overrides: Sequence[str] = ()) -> tuple[int, pa.Table]:
    """Type the runs of an output directory again and renew its summary.

    Parameters
    ----------
    directory : Path
    overrides : sequence of str
        ``classify.KEY=VALUE`` texts over the directory's own thresholds.

    Returns
    -------
    changed : int
        Runs whose type has changed.
    summary : pa.Table

    Raises
    ------
    ConfigError
        If this is no output directory, or an override is not of ``classify``.
    OutputError
        If a file is damaged or cannot be written.
    """
    store = Store(directory)
    manifest = read_manifest(store)
    for text in overrides:
        if not text.strip().startswith("classify."):
            raise ConfigError(
                f"--set {text}: only keys of classify can change without integrating, such as "
                "classify.sw_departure=0.1"
            )
    config = override_config(manifest["config"], overrides)
    changed = retype_blocks(store, config.classify)
    summary = summarise(store, stored_cases(manifest))
    store.write_summary(summary)
    manifest["config"] = resolved(config)
    store.write_manifest(manifest)
    return changed, summary


@dataclass(frozen=True)
class StoredCase:
    """A case as the manifest names it."""

    index: int
    target_name: str | None
    target: float | None
    n_i: float | None
    omega_xy0: float | None


def stored_cases(manifest: dict[str, Any]) -> list[StoredCase]:
    """Cases of an output directory."""
    cases = []
    for entry in manifest["cases"]:
        name = next((key for key in ("K_p", "K_r") if key in entry), None)
        target = entry[name] if name else None
        cases.append(
            StoredCase(entry["case"], name, target, entry.get("n_i"), entry.get("omega_xy0"))
        )
    return cases


def _floats(table: pa.Table, name: str) -> NDArray[np.float64]:
    values: NDArray[np.float64] = table.column(name).to_numpy()
    return values


def _typed(table: pa.Table, thresholds: Classify) -> pa.Array:
    status: Any = table.column("status").to_numpy()
    codes = classify(
        status == "ok",
        _floats(table, "t_r"),
        _floats(table, "amp_growth"),
        _floats(table, "n_departure"),
        thresholds,
    )
    indices = pa.array(codes, mask=codes < 0)
    return pa.DictionaryArray.from_arrays(indices, pa.array(TYPES)).cast(pa.string())


def _differing(before: pa.Array, after: pa.Array) -> int:
    changed = pc.not_equal(pc.fill_null(before, ""), pc.fill_null(after, ""))
    return int(pc.sum(changed).as_py() or 0)
