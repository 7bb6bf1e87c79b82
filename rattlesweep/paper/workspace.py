"""The command's output directory: sweeps, the figures' tables, and of which code they are.

``paper.json`` records the key of each figure's tables and of each sweep, so that a command that was
stopped resumes: what is whole and of today's key is kept, all else is made again.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa

from rattlesweep.errors import OutputError
from rattlesweep.paper.settings import Sizes, sweep_config
from rattlesweep.sweeps.cases.plan import Plan, make_plan
from rattlesweep.sweeps.config.load import parse_config, resolved
from rattlesweep.sweeps.config.schema import Config
from rattlesweep.sweeps.engines.run import run_sweep
from rattlesweep.sweeps.store.atomic import probe_directory, reason, replace_file
from rattlesweep.sweeps.store.store import Store
from rattlesweep.sweeps.tables.arrow import DamagedError, encode, open_sealed

RECORD = "paper.json"
# Columns that say how a run was launched.
LAUNCH = ("alpha", "beta", "gamma", "theta", "phi", "xi", "n_i", "omega_xy0", "psi")
PACKAGE = Path(__file__).resolve().parents[1]
# What the runs of a sweep depend on, the tables of a figure besides, and its picture besides.
OF_RUNS = ("physics", "integrate", "sweeps")
OF_TABLES = (*OF_RUNS, "study/onerun", "paper/data", "paper/workspace.py", "paper/steady.yaml",
             "paper/unsteady.yaml")  # fmt: skip
OF_PICTURES = ("study/style.py", "paper/figures")
# What a killed process may leave of the files written here.
_TEMPORARY = re.compile(
    r"\.(fig\w+\.(parquet|svg|png)|claims\.parquet|report\.html|paper\.json)\.[0-9a-f]{8}\.tmp"
)


@cache
def code_key(*places: str) -> str:
    """Hash of the sources in folders and files of the package."""
    digest = hashlib.sha256()
    for place in places:
        root = PACKAGE / place
        for path in sorted(root.rglob("*.py")) if root.is_dir() else [root]:
            digest.update(f"{path.relative_to(PACKAGE)}\n".encode() + path.read_bytes())
    return digest.hexdigest()


class StoredRuns:
    """The runs of a finished sweep, those whose status is ``ok``.

    Attributes
    ----------
    config : Config
    target : str
        ``K_p`` or ``K_r``, which the cases of the sweep have as target.
    """

    def __init__(self, plan: Plan, store: Store) -> None:
        self.config = plan.config
        self.target = str(plan.cases[0].target_name)
        self._cases, self._store = plan.cases, store

    def runs(self, columns: Sequence[str]) -> pd.DataFrame:
        """These columns, and ``case``; the target of the case, unless its column is among them."""
        batches = self._store.iter_batches(list(dict.fromkeys(("case", "status", *columns))))
        found: pd.DataFrame = pa.Table.from_batches(batches).to_pandas()
        found = found[found["status"] == "ok"].drop(columns="status").reset_index(drop=True)
        if self.target not in columns:
            targets = np.array([case.target for case in self._cases], dtype=float)
            found[self.target] = targets[found["case"]]
        return found

    def points(self, columns: Sequence[str]) -> Iterator[tuple[dict[str, Any], pd.DataFrame]]:
        """Each case in order: its target and launch, and its runs, of which there may be none."""
        runs = self.runs(columns)
        for case in self._cases:
            point = {self.target: case.target, "n_i": case.n_i, "omega_xy0": case.omega_xy0}
            yield point, runs[runs["case"] == case.index].reset_index(drop=True)


class Workspace:
    """An output directory, and what is made in it.

    Parameters
    ----------
    directory : Path
    sizes : Sizes
    threads : int

    Attributes
    ----------
    record : dict
        What ``paper.json`` says.
    """

    def __init__(self, directory: Path, sizes: Sizes, threads: int) -> None:
        probe_directory(directory)
        for path in directory.glob(".*.tmp"):
            if _TEMPORARY.fullmatch(path.name):
                path.unlink(missing_ok=True)
        self.directory, self.sizes, self.threads = directory, sizes, threads
        self.record = _read_record(directory / RECORD)
        self._sweeps: dict[str, StoredRuns] = {}

    def save(self) -> None:
        """Write the record."""
        text = json.dumps(self.record, indent=2, allow_nan=False, ensure_ascii=False)
        replace_file(self.directory / RECORD, text.encode() + b"\n")

    # ------------------------------------------------------------------------------- tables

    def table_path(self, figure: str, table: str) -> Path:
        """Where a table of a figure has its place."""
        return self.directory / f"{figure}_{table}.parquet"

    def load_or_make(
        self, figure: str, make: Callable[[], Mapping[str, pa.Table]]
    ) -> Mapping[str, pa.Table]:
        """Tables of a figure: those on disk if they are whole and of this key, else new ones."""
        tables = self.load(figure)
        if tables is None:
            tables = make()
            for name, table in tables.items():
                replace_file(self.table_path(figure, name), encode(table))
            # Last: it names only what is there.
            self.record["figures"][figure] = {"key": self._key(), "tables": list(tables)}
            self.save()
        return tables

    def load(self, figure: str) -> Mapping[str, pa.Table] | None:
        """Tables of a figure that are whole on disk and of this key; None if one is not."""
        entry = self.record["figures"].get(figure, {})
        if entry.get("key") != self._key():
            return None
        try:
            return {
                name: open_sealed(self.table_path(figure, name).read_bytes())
                .read()
                .replace_schema_metadata(None)
                for name in entry["tables"]
            }
        except (OSError, DamagedError):
            return None

    def _key(self) -> str:
        text = json.dumps(asdict(self.sizes)) + code_key(*OF_TABLES)
        return hashlib.sha256(text.encode()).hexdigest()

    def draw_if_needed(self, figure: str, draw: Callable[[], Mapping[str, bytes]]) -> None:
        """Write a figure's pictures, unless they are there and of today's tables and drawing.

        Parameters
        ----------
        figure : str
        draw : callable
            Makes the bytes of the pictures ``svg`` and ``png``.
        """
        entry, drawing = self.record["figures"][figure], code_key(*OF_PICTURES)
        paths = {kind: self.directory / f"{figure}.{kind}" for kind in ("svg", "png")}
        if entry.get("drawn") != drawing or not all(path.exists() for path in paths.values()):
            for kind, data in draw().items():
                replace_file(paths[kind], data)
            entry["drawn"] = drawing
            self.save()

    # ------------------------------------------------------------------------------- sweeps

    def sweep(self, direction: str, progress: Callable[[float, str], None]) -> StoredRuns:
        """The sweep ``steady`` or ``unsteady``, run at the first call.

        Raises
        ------
        ConfigError
            If the directory holds the runs of another config.
        """
        if direction not in self._sweeps:
            config = sweep_config(direction, self.sizes)
            self._sweeps[direction] = self._run(direction, config, code_key(*OF_RUNS), progress)
        return self._sweeps[direction]

    def again(
        self,
        name: str,
        runs: pd.DataFrame,
        columns: Sequence[str],
        progress: Callable[[float, str], None],
        **changes: Any,
    ) -> pd.DataFrame:
        """Integrate runs of the steady sweep once more, as a sweep of its own.

        Parameters
        ----------
        name : str
            Of the new sweep.
        runs : DataFrame
            With the columns :data:`LAUNCH`.
        columns : sequence of str
            Of the new runs, to be given back.
        changes
            Keys of the config, such as ``record``.

        Returns
        -------
        DataFrame
            One row a run, with the index of ``runs``; null where it failed.
        """
        data = encode(pa.Table.from_pandas(runs[list(LAUNCH)], preserve_index=False))
        path = self.directory / "sweeps" / name / "bodies.parquet"
        steady = sweep_config("steady", self.sizes)
        config = resolved(steady.model_copy(update={"name": name, "block_size": 1000, **changes}))
        config |= {"bodies": {"source": "table", "path": str(path)}}
        del config["spin"]
        text = json.dumps(config) + hashlib.sha256(data).hexdigest() + code_key(*OF_RUNS)
        key = hashlib.sha256(text.encode()).hexdigest()
        if self.record["sweeps"].get(name) != key or not path.exists():
            self.record["sweeps"][name] = "other"
            self.save()
            probe_directory(path.parent)
            replace_file(path, data)
        found = self._run(name, parse_config(config), key, progress).runs(("sample", *columns))
        return (
            found.set_index("sample")[list(columns)].reindex(range(len(runs))).set_axis(runs.index)
        )

    def _run(
        self, name: str, config: Config, key: str, progress: Callable[[float, str], None]
    ) -> StoredRuns:
        """Run a sweep; runs that are there, but of another key, are removed first."""
        folder, keys = self.directory / "sweeps" / name, self.record["sweeps"]
        begun = (folder / "manifest.json").exists()
        # Runs from before the code was recorded are kept.
        fresh = begun and keys.get(name, key) != key
        # Until the new ones are complete, those of another key may still be among them.
        keys[name] = "other" if fresh else key
        self.save()
        plan = make_plan(config)
        run_sweep(
            plan, folder, threads=self.threads, fresh=fresh,
            report=lambda p: progress(p.fraction, f"{config.name}: {p.runs}/{p.total} runs"),
        )  # fmt: skip
        keys[name] = key
        self.save()
        return StoredRuns(plan, Store(folder))

    def failed(self, sweeps: Sequence[str]) -> int:
        """Runs of these sweeps whose status is not ``ok``."""
        stores = [Store(self.directory / "sweeps" / name) for name in sweeps]
        return sum(
            sum(store.read_manifest().failed.values()) for store in stores if store.has_manifest()
        )


def _read_record(path: Path) -> dict[str, Any]:
    record: Any = None
    try:
        record = json.loads(path.read_bytes())
    except OSError as error:
        if not isinstance(error, FileNotFoundError):
            raise OutputError(f"cannot read {path}: {reason(error)}") from error
    except ValueError:
        # It vouches for the data; without it they are made again.
        pass
    found = record if isinstance(record, dict) else {}
    return {"format": 1, "figures": {}, "sweeps": {}} | found
