"""The sweeps behind Figs. 5 to 7: run, or read from an earlier session, case by case."""

from __future__ import annotations

from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
import pyarrow as pa

from rattlesweep.errors import ConfigError
from rattlesweep.paper.sources import code_key
from rattlesweep.sweeps.cases.plan import Case, Plan, make_plan
from rattlesweep.sweeps.config.load import Config, parse_config, resolved
from rattlesweep.sweeps.engines.opened import examine
from rattlesweep.sweeps.engines.run import run_sweep
from rattlesweep.sweeps.store.atomic import probe_directory, replace_file
from rattlesweep.sweeps.store.store import Store
from rattlesweep.sweeps.tables.arrow import encode

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from numpy.typing import NDArray

    from rattlesweep.paper.settings import Paper
    from rattlesweep.sweeps.engines.progress import Progress

    Report = Callable[[float, str], None]

LAUNCH = ("alpha", "beta", "gamma", "theta", "phi", "xi", "n_i", "omega_xy0", "psi")


@dataclass(frozen=True)
class Sweep:
    """A finished sweep on disk."""

    plan: Plan
    store: Store

    def cases(self, columns: Sequence[str]) -> Iterator[tuple[Case, pd.DataFrame]]:
        """Yield each case with these columns of its runs; one case is held at a time.

        Runs whose status is not ok are left out.
        """
        wanted = list(dict.fromkeys(("case", "status", *columns)))
        held: list[pa.RecordBatch] = []
        current = 0
        for batch in self.store.iter_batches(wanted):
            numbers = batch.column("case").to_numpy(zero_copy_only=False)
            first = 0
            while first < batch.num_rows:
                if (number := int(numbers[first])) != current:
                    yield self._frame(current, held)
                    current, held = number, []
                stop = int(numbers.searchsorted(number, side="right"))
                held.append(batch.slice(first, stop - first))
                first = stop
        if held:
            yield self._frame(current, held)

    def _frame(self, number: int, held: list[pa.RecordBatch]) -> tuple[Case, pd.DataFrame]:
        frame: pd.DataFrame = pa.Table.from_batches(held).to_pandas()
        good = frame[frame["status"] == "ok"].drop(columns=["case", "status"])
        return self.plan.cases[number], good.reset_index(drop=True)


def carry_out(
    config: Config, directory: Path, threads: int, report: Report, *, fresh: bool = False
) -> Sweep:
    """Run a sweep, or what of it is not yet on disk.

    Parameters
    ----------
    config : Config
    directory : Path
    threads : int
    report : callable
        Called with the fraction done and a few words; may raise to stop.
    fresh : bool
        Whether to remove the runs that are there first.

    Raises
    ------
    ConfigError
        If the directory holds another sweep.
    """
    plan = make_plan(config)

    def say(progress: Progress) -> None:
        report(progress.fraction, f"{config.name}: {progress.runs}/{progress.total} runs")

    run_sweep(plan, directory, threads=threads, report=say, fresh=fresh)
    return Sweep(plan, Store(directory))


def carry_out_derived(
    config: Config,
    directory: Path,
    threads: int,
    report: Report,
    table: pa.Table,
    *,
    fresh: bool = False,
) -> Sweep:
    """Run a sweep of bodies that another one found; an old one of others gives way.

    Parameters
    ----------
    config, directory, threads, report, fresh
        As for :func:`carry_out`.
    table : pyarrow.Table
        Bodies and launches, which take the place of the config's.
    """
    bodies = directory / "bodies.parquet"
    data = encode(table)
    source = {"source": "table", "path": str(bodies)}
    rest = {key: value for key, value in resolved(config).items() if key != "spin"}
    config = parse_config(rest | {"bodies": source})
    if not bodies.exists() or bodies.read_bytes() != data:
        fresh = True
        probe_directory(directory)
        replace_file(bodies, data)
    elif not fresh:
        try:
            examine(make_plan(config), directory, None)
        except ConfigError:
            fresh = True
    return carry_out(config, directory, threads, report, fresh=fresh)


def bodies_of(runs: pd.DataFrame, horizon: NDArray[np.float64] | None = None) -> pa.Table:
    """Bodies and launches of runs, as a table that a sweep can begin from.

    Parameters
    ----------
    runs : DataFrame
        With the columns of :data:`LAUNCH`.
    horizon : ndarray, optional
        Horizons of the runs; by default the sweep's own.
    """
    table = runs[list(LAUNCH)]
    if horizon is not None:
        table = table.assign(t_end=horizon)
    return pa.Table.from_pandas(table, preserve_index=False)


def horizons(config: Config, t_rgh: NDArray[np.float64]) -> NDArray[np.float64]:
    """Horizons that a config gives to runs with these reversal times of Garcia and Hubbard."""
    h = config.horizon
    end = np.full(len(t_rgh), np.inf if h.t is None else h.t)
    return end if h.t_rgh is None else np.minimum(end, h.t_rgh * t_rgh)


@dataclass
class Place:
    """Where the figures are made: settings, directory, threads, and the sweeps that are done."""

    paper: Paper
    directory: Path
    threads: int
    # The code that the runs of each sweep are of, as the record has it, and what saves that.
    codes: dict[str, str] = field(default_factory=dict)
    save: Callable[[], None] = lambda: None
    _done: dict[str, Sweep] = field(default_factory=dict)

    def sweep(self, name: str, report: Report) -> Sweep:
        """The sweep ``unsteady`` or ``steady``, run at the first call."""
        if name not in self._done:
            config: Config = getattr(self.paper, name)
            with self._of_this_code(name) as (folder, fresh):
                self._done[name] = carry_out(config, folder, self.threads, report, fresh=fresh)
        return self._done[name]

    def derived(self, name: str, config: Config, report: Report, table: pa.Table) -> Sweep:
        """A sweep of bodies that another one found; see :func:`carry_out_derived`."""
        with self._of_this_code(name) as (folder, fresh):
            return carry_out_derived(config, folder, self.threads, report, table, fresh=fresh)

    @contextmanager
    def _of_this_code(self, name: str) -> Iterator[tuple[Path, bool]]:
        """Directory of a sweep, and whether the runs there are of other code.

        Runs from before the code was recorded are kept.
        """
        folder, key = self.directory / "sweeps" / name, code_key("sweeps")
        begun = (folder / "manifest.json").exists()
        fresh = begun and self.codes.get(name, key) != key
        if not begun or fresh:
            # Until the new ones are complete, those of other code may still be among them.
            self.codes[name] = "" if fresh else key
            self.save()
        yield folder, fresh
        if fresh:
            self.codes[name] = key
            self.save()


def part(report: Report, low: float, high: float) -> Report:
    """Report the share from ``low`` to ``high`` of something larger."""
    return lambda fraction, text: report(low + (high - low) * fraction, text)
