"""Bodies of closed meshes, a case each."""

from __future__ import annotations

import hashlib
import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from rattlesweep.arrays import Floats, Integers, take
from rattlesweep.config.body_sources import MeshSource
from rattlesweep.design.bodies.table import run_fields
from rattlesweep.physics.body import PARAMETERS, Rattleback
from rattlesweep.physics.mesh.oddities import doubts_of
from rattlesweep.physics.mesh.reading import read_standing
from rattlesweep.physics.si import Units
from rattlesweep.rows.prepared import Bodies
from rattlesweep.system.files import as_path, reason
from rattlesweep.words.errors import ConfigError


@dataclass(frozen=True)
class MeshBodies:
    """Bodies of meshes; the target of a case is the number of its mesh."""

    columns: dict[str, Floats]
    units: Units
    carried: dict[str, NDArray[np.generic]]
    doubts: tuple[str, ...]  # messages that begin with the key
    content_hash: str  # of the files
    samples: int = 1

    @property
    def fields(self) -> tuple[pa.Field, ...]:
        """Columns that the bodies add to the runs."""
        return run_fields(self.units, self.carried)

    def bodies(self, target: float | Floats, sample: Integers) -> Bodies:
        """Return the bodies of some runs; without a target, the first mesh."""
        number = np.broadcast_to(np.nan_to_num(target), sample.shape).astype(np.int64)
        return Bodies.of(
            take(self.columns, number),
            f_sd=np.full(len(sample), np.nan),
            units=take(self.units, number),
            carried=take(self.carried, number),
        )


def read_meshes(source: MeshSource, base: Path | None) -> MeshBodies:
    """Return the bodies of a config's meshes, which are files here or in `base`."""
    found: list[Rattleback] = []
    doubts: list[str] = []
    digest = hashlib.sha256()
    for path in source.path:
        file = as_path(path, "bodies.path")
        if base is not None and not os.path.exists(file):
            file = base / file
        try:
            digest.update(hashlib.sha256(file.read_bytes()).digest())
            standing = read_standing(
                file, source.unit, source.mass, source.density, source.points, source.up
            )
            found.append(Rattleback.of_standing(standing))
        except OSError as error:
            raise ConfigError(f"bodies.path: {path}: {reason(error)}") from None
        except ValueError as error:
            raise ConfigError(f"bodies.path: {error}") from None
        doubts += [f"bodies.path: {path}: {doubt}" for doubt in doubts_of(standing)]
    columns = {}
    for name in (*PARAMETERS, "c", "rim"):
        values = [getattr(body, name) for body in found]
        columns[name] = _rounded(values)
    units = [body.units for body in found if body.units is not None]
    masses = _rounded([each.mass for each in units])
    heights = _rounded([each.length for each in units])
    carried: dict[str, NDArray[np.generic]] = {
        "mesh": np.array(source.path, dtype=object),
        "mass_kg": masses,
        "height_m": heights,
        "rim": columns.pop("rim"),
    }
    size = Units(masses, heights)
    return MeshBodies(columns, size, carried, tuple(doubts), digest.hexdigest())


def _rounded(values: list[float | None]) -> Floats:
    """Return numbers without their last digits, which vary with threads and machine."""
    numbers = [np.nan if value is None else float(f"{value:.11g}") for value in values]
    return np.array(numbers)
