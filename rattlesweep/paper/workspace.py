"""The command's output directory: sweeps, the figures' tables, and of which code they are.

``paper.json`` records the key of each figure and of each sweep, so that a command that was stopped
resumes: what is whole and of today's key is kept, all else is made again.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
from matplotlib.figure import Figure as Drawing

from rattlesweep.child import PACKAGE
from rattlesweep.errors import DamagedError
from rattlesweep.sweeps.plan import Case, make_plan
from rattlesweep.sweeps.config.read import load_config, parse_config, resolved
from rattlesweep.sweeps.config.schema import Config
from rattlesweep.sweeps.run import run_sweep
from rattlesweep.sweeps.files import explained, probe_directory, replace_file
from rattlesweep.sweeps.old.store import Store
from rattlesweep.sweeps.arrow import encode, open_sealed, read_rows

Tables = Mapping[str, pa.Table]
# Told the share that is done and a few words; may raise to stop the work.
Progress = Callable[[float, str], None]

RECORD, KINDS = "paper.json", ("png", "svg")
# Columns that say how a run was launched.
LAUNCH = ("alpha", "beta", "gamma", "theta", "phi", "xi", "n_i", "omega_xy0", "psi")
# What the runs of a sweep depend on, and a figure besides.
OF_RUNS = ("physics", "integrate", "sweeps")
OF_FIGURES = (*OF_RUNS, "study/onerun", "study/style.py",
              *map("paper/{}".format, ("figures", "columns.py", "drawing.py", "workspace.py",
                                       "steady.yaml", "unsteady.yaml")))  # fmt: skip
# What a killed process may leave of the files written here.
_TEMPORARY = re.compile(
    r"\.(fig\w+\.(parquet|svg|png)|claims\.parquet|report\.html|paper\.json)\.[0-9a-f]{8}\.tmp"
)


@dataclass(frozen=True)
class Sizes:
    """How many samples the figures are made of, and one length.

    Numbers that no one changes stand at the head of the modules in ``figures/``.
    """

    fig2_bodies: int = 1_000_000  # the paper's number
    fig3_bodies: int = 100_000  # of (a), the paper's number
    fig3_density: int = 100_000_000  # bodies of (b), the paper's number
    samples: int = 1000  # of each point of Figs. 5 to 7, the paper's number
    rk4: int = 10  # samples of each case of Fig. 6 that are integrated with RK4 as well
    rk4_least_K_r: float = 0.0  # targets below are left out of this: they take longest
    lyapunov: int = 20_000  # most runs of type SW that are tried for chaos
    windows: int = 6000  # most runs of Fig. 7 that are followed in windows of time
    fig8_lyapunov_t_end: float = 500_000.0


FULL = Sizes()
QUICK = Sizes(
    fig2_bodies=50_000,
    fig3_density=2_000_000,
    samples=30,
    rk4=1,
    rk4_least_K_r=0.03,
    lyapunov=200,
    fig8_lyapunov_t_end=62_500.0,
)


def sweep_config(direction: str, sizes: Sizes) -> Config:
    """Config of the sweep of a direction, ``steady`` or ``unsteady``: that of ``configs/``."""
    path = Path(__file__).with_name(f"{direction}.yaml")
    return load_config(path, [f"bodies.samples={sizes.samples}"])


@dataclass(frozen=True)
class Figure:
    """A figure of the paper: words for people, its tables from a workspace, its picture from them.

    Attributes
    ----------
    seconds : tuple of float
        That it takes, roughly, at full size and with ``--quick``, on two cores of an EPYC server
        (Zen 5), without the sweep.
    sweep : str, optional
        Name of the sweep that it reads.
    """

    title: str
    caption: str
    data: Callable[[Workspace, Progress], Tables]
    draw: Callable[[Tables], Drawing]
    seconds: tuple[float, float]
    sweep: str | None = None


def between(progress: Progress, low: float, high: float) -> Progress:
    """Progress of a part, which is the share from ``low`` to ``high`` of something larger."""
    return lambda share, words: progress(low + (high - low) * share, words)


@cache
def code_key(*places: str) -> str:
    """Hash of the sources in folders and files of the package."""
    digest = hashlib.sha256()
    for place in places:
        root = PACKAGE / place
        for path in sorted(root.rglob("*.py")) if root.is_dir() else [root]:
            digest.update(f"{path.relative_to(PACKAGE)}\n".encode() + path.read_bytes())
    return digest.hexdigest()


@dataclass(frozen=True)
class StoredRuns:
    """The runs of a finished sweep whose status is ``ok``; ``K_p`` or ``K_r`` is the case's target.

    The body's own coefficient has ``_body`` behind its name.
    """

    config: Config
    cases: Sequence[Case]
    runs: pd.DataFrame

    @classmethod
    def read(cls, config: Config, cases: Sequence[Case], store: Store) -> StoredRuns:
        """Of a directory."""
        runs: pd.DataFrame = pa.Table.from_batches(store.iter_batches()).to_pandas()
        runs = runs[runs["status"] == "ok"].reset_index(drop=True)
        if name := cases[0].target_name:
            runs[f"{name}_body"] = runs[name]
            runs[name] = np.array([case.target for case in cases])[runs["case"]]
        return cls(config, cases, runs)

    @property
    def target(self) -> str:
        """``K_p`` or ``K_r``."""
        return str(self.cases[0].target_name)

    def points(self) -> Iterator[tuple[dict[str, Any], pd.DataFrame]]:
        """Each case in order: its target and launch, and its runs, of which there may be none."""
        found = dict(list(self.runs.groupby("case")))
        for case in self.cases:
            point = {self.target: case.target, "n_i": case.n_i, "omega_xy0": case.omega_xy0}
            yield point, found.get(case.index, self.runs[:0]).reset_index(drop=True)


class Workspace:
    """An output directory, and what is made in it; ``record`` is what ``paper.json`` says."""

    def __init__(self, directory: Path, sizes: Sizes, threads: int) -> None:
        probe_directory(directory)
        tidy(directory)
        self.directory, self.sizes, self.threads = directory, sizes, threads
        empty: dict[str, Any] = {"format": 1, "figures": {}, "sweeps": {}}
        self.record = empty | _read(directory / RECORD)
        self._sweeps: dict[str, StoredRuns] = {}

    def save(self) -> None:
        """Write the record."""
        text = json.dumps(self.record, indent=2, allow_nan=False, ensure_ascii=False)
        replace_file(self.directory / RECORD, text.encode() + b"\n")

    def load(self, figure: str) -> Tables | None:
        """Tables of a figure that are whole on disk and of today's key; None if one is not."""
        entry = self.record["figures"].get(figure, {})
        if entry.get("key") != self._figures_key():
            return None
        try:
            return {name: read_table(self.directory, figure, name) for name in entry["tables"]}
        except (OSError, DamagedError):
            return None

    def load_or_make(self, name: str, figure: Figure, progress: Progress) -> Tables:
        """Tables of a figure, which are kept; what there is already stays."""
        tables = self.load(name)
        if tables is None:
            tables = figure.data(self, progress)
            # Those that there are show other data.
            for kind in KINDS:
                (self.directory / f"{name}.{kind}").unlink(missing_ok=True)
            for part, table in tables.items():
                replace_file(self.directory / f"{name}_{part}.parquet", encode(table))
            # Last: it names only what is there.
            entry = {"key": self._figures_key(), "tables": list(tables)}
            self.record["figures"][name] = entry
            self.save()
        return tables

    def has_pictures(self, name: str) -> bool:
        """Whether all pictures of a figure are there."""
        return all((self.directory / f"{name}.{kind}").exists() for kind in KINDS)

    def _figures_key(self) -> str:
        return _digest(json.dumps(asdict(self.sizes)), code_key(*OF_FIGURES))

    def sweep(self, direction: str, progress: Progress) -> StoredRuns:
        """The sweep ``steady`` or ``unsteady``, run at the first call.

        Raises
        ------
        ConfigError
            If the directory holds the runs of another config.
        """
        if direction not in self._sweeps:
            config, key = sweep_config(direction, self.sizes), code_key(*OF_RUNS)
            self._sweeps[direction] = self._run(direction, config, key, progress)
        return self._sweeps[direction]

    def again(
        self, name: str, runs: pd.DataFrame, progress: Progress, **changes: Any
    ) -> pd.DataFrame:
        """Integrate runs of the steady sweep once more, as a sweep of its own.

        ``runs`` have the columns :data:`LAUNCH`; ``changes`` are keys of the config, such as
        ``record``.  The new runs have the index of ``runs``, and are null where one failed.
        """
        bodies = encode(pa.Table.from_pandas(runs[list(LAUNCH)], preserve_index=False))
        path = self.directory / "sweeps" / name / "bodies.parquet"
        config = resolved(sweep_config("steady", self.sizes)) | changes
        config |= {"name": name, "bodies": {"source": "table", "path": str(path)}}
        del config["spin"]
        key = _digest(json.dumps(config), hashlib.sha256(bodies).hexdigest(), code_key(*OF_RUNS))
        found = self._run(name, parse_config(config), key, progress, bodies).runs
        return found.set_index("sample").reindex(range(len(runs))).set_axis(runs.index)

    def _run(
        self, name: str, config: Config, key: str, progress: Progress, bodies: bytes = b""
    ) -> StoredRuns:
        """Run a sweep; runs that are there, but of another key, are removed first."""
        folder, keys = self.directory / "sweeps" / name, self.record["sweeps"]
        begun = (folder / "manifest.json").exists()
        # Runs from before the code was recorded are kept.
        fresh = begun and keys.get(name, key) != key
        # Until the new ones are complete, those of another key may still be among them.
        keys[name] = "other" if fresh else key
        self.save()
        if bodies:
            probe_directory(folder)
            replace_file(folder / "bodies.parquet", bodies)
        plan = make_plan(config)
        run_sweep(
            plan, folder, threads=self.threads, fresh=fresh,
            report=lambda p: progress(p.fraction, f"{name}: {p.runs}/{p.total} runs"),
        )  # fmt: skip
        keys[name] = key
        self.save()
        return StoredRuns.read(config, plan.cases, Store(folder))

    def failed(self, sweeps: Sequence[str]) -> int:
        """Runs of these sweeps whose status is not ``ok``."""
        stores = [Store(self.directory / "sweeps" / name) for name in sweeps]
        return sum(
            sum(store.read_manifest().failed.values()) for store in stores if store.has_manifest()
        )


def read_table(directory: Path, figure: str, name: str) -> pa.Table:
    """A table of a figure.

    Raises
    ------
    OSError, DamagedError
        If it is not there, or not whole.
    """
    return read_rows(open_sealed((directory / f"{figure}_{name}.parquet").read_bytes()))


def tidy(directory: Path) -> None:
    """Remove what a killed process has left half-written."""
    for path in directory.glob(".*.tmp"):
        if _TEMPORARY.fullmatch(path.name):
            path.unlink(missing_ok=True)


def _digest(*texts: str) -> str:
    return hashlib.sha256("".join(texts).encode()).hexdigest()


def _read(path: Path) -> dict[str, Any]:
    """The record; it vouches for the data, and where it is none they are made again."""
    with explained(f"cannot read {path}"), suppress(FileNotFoundError, ValueError):
        record = json.loads(path.read_bytes())
        return record if isinstance(record, dict) else {}
    return {}
