"""The command's output directory: tables of the figures and the sweeps that these need.

The sweeps are ordinary ones in ``sweeps/NAME`` and resume by themselves.  All else takes seconds
and is computed anew by each call.
"""

from __future__ import annotations

import io
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from rattlesweep.progress import Bar
from rattlesweep.sweeps.config.read import load_config, parse_config, resolved
from rattlesweep.sweeps.config.schema import Config
from rattlesweep.sweeps.files import probe_directory, replace_file
from rattlesweep.sweeps.plan import make_plan
from rattlesweep.sweeps.run import run_sweep
from rattlesweep.sweeps.stored import Stored, open_stored
from rattlesweep.sweeps.summary import read_summary

Tables = Mapping[str, pd.DataFrame]
# Told the share of some work that is done.
Report = Callable[[float], None]

# Columns that say how a run was launched.
LAUNCH = ["alpha", "beta", "gamma", "theta", "phi", "xi", "n_i", "omega_xy0", "psi"]
HERE = Path(__file__).parent


@dataclass(frozen=True)
class Sizes:
    """Numbers of samples, and one length; ``samples`` and the bodies are the paper's numbers."""

    fig3_bodies: int = 1_000_000
    fig4_bodies: int = 100_000  # of (a)
    fig4_density: int = 100_000_000  # of (b)
    samples: int = 1000  # of each point of Figs. 6 to 8
    rk4: int = 10  # samples of each case of Fig. 7 that are integrated with RK4 as well
    rk4_least_K_r: float = 0.0  # bodies of smaller K_r take longest and are left out of this
    lyapunov: int = 20_000  # most runs of type SW that are tried for chaos
    windows: int = 6000  # most runs of Fig. 8 that are followed in windows of time
    friction: int = 1000  # bodies under friction
    exponents_t_end: float = 500_000.0


FULL = Sizes()
QUICK = Sizes(
    fig3_bodies=50_000,
    fig4_density=2_000_000,
    samples=30,
    rk4=1,
    rk4_least_K_r=0.03,
    lyapunov=200,
    friction=60,
    exponents_t_end=62_500.0,
)


def sweep_config(direction: str, sizes: Sizes) -> Config:
    """Return the config of the sweep ``steady`` or ``unsteady``: that of ``configs/``."""
    return load_config(HERE / f"{direction}.yaml", [f"bodies.samples={sizes.samples}"])


class Workspace:
    """An output directory, the sizes of what is made there, and the bar that shows how far it is.

    Attributes
    ----------
    failed : int
        Runs of its sweeps, so far, whose status is not ``ok``.
    """

    def __init__(
        self, directory: Path, sizes: Sizes, threads: int | None = None, bar: Bar | None = None
    ) -> None:
        probe_directory(directory)
        self.directory, self.sizes, self.threads = directory, sizes, threads
        self.bar = bar or Bar(shown=False)
        self.failed = 0
        self._sweeps: dict[str, pd.DataFrame] = {}

    def reporting(self, words: str) -> Report:
        """Return what shows the share of some work on the bar."""
        return self.bar.counting(words)

    def sweep(self, name: str, config: Config | None = None) -> pd.DataFrame:
        """Run a sweep, or go on with it, and return its runs with status ``ok``.

        Beside the columns of ``runs``: where the cases have a target, ``K_p`` or ``K_r`` is the
        target and the body's own coefficient has ``_body`` behind its name.  Without a config it is
        ``steady`` or ``unsteady``.

        Raises
        ------
        ConfigError
            If the directory holds the runs of another config.
        """
        if name not in self._sweeps:
            base = self.directory / "sweeps"
            plan = make_plan(config or sweep_config(name, self.sizes), base)
            run_sweep(plan, base / name, base=base, threads=self.threads, report=self.bar)
            self._sweeps[name] = self._read(open_stored(base / name))
        return self._sweeps[name]

    def again(self, name: str, runs: pd.DataFrame, **changes: Any) -> pd.DataFrame:
        """Integrate runs of the steady sweep once more, as a sweep of its own.

        Parameters
        ----------
        name : str
            Name of the new sweep.
        runs : DataFrame
            Runs with the columns :data:`LAUNCH`.
        **changes
            Keys of the config that differ, such as ``record``.

        Returns
        -------
        DataFrame
            The new runs with the index of ``runs``, null where one failed.
        """
        if runs.empty:
            return pd.DataFrame(index=runs.index)
        path = self.directory / "sweeps" / f"{name}.parquet"
        probe_directory(path.parent)
        replace_file(path, runs[LAUNCH].to_parquet(index=False))
        config = resolved(sweep_config("steady", self.sizes)) | changes
        config |= {"name": name, "bodies": {"source": "table", "path": path.name}}
        del config["spin"]
        found = self.sweep(name, parse_config(config))
        return found.set_index("sample").reindex(range(len(runs))).set_axis(runs.index)

    def _read(self, stored: Stored) -> pd.DataFrame:
        runs: pd.DataFrame = stored.read().to_pandas()
        good = runs["status"] == "ok"
        self.failed += int((~good).sum())
        runs = runs[good].reset_index(drop=True)
        cases = read_summary(stored).to_pandas().set_index("case")
        for target in ("K_p", "K_r"):
            if cases[target].notna().any():
                runs[f"{target}_body"] = runs[target]
                runs[target] = runs["case"].map(cases[target])
        return runs


def write_table(path: Path, frame: pd.DataFrame) -> None:
    """Write a table in one step; what is not a number is null."""
    buffer = io.BytesIO()
    table = pa.Table.from_pandas(frame, preserve_index=False).replace_schema_metadata()
    pq.write_table(table, buffer, write_page_checksum=True)
    replace_file(path, buffer.getvalue())


def thinned_out(runs: pd.DataFrame, most: int) -> pd.DataFrame:
    """Return at most so many of the runs, evenly chosen, so that all cases keep their share."""
    return runs.iloc[:: max(1, -(-len(runs) // most))].reset_index(drop=True)


def records(frame: pd.DataFrame) -> list[dict[str, Any]]:
    """Return the rows of a table, each by the names of its columns."""
    rows: list[Any] = frame.to_dict("records")
    return rows


def at(runs: pd.DataFrame, values: Mapping[str, float]) -> pd.Series[bool]:
    """Return which runs have these values."""
    return (runs[list(values)] == pd.Series(values)).all(axis=1)
