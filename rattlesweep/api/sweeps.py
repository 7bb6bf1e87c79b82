"""Sweeps: run them, and read what they left."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rattlesweep.errors import ConfigWarning

if TYPE_CHECKING:
    from collections.abc import Mapping

    import pandas as pd


class Sweep:
    """An output directory; tables are read when they are asked for.

    Parameters
    ----------
    directory : path
        Of a sweep, whole or still running.

    Attributes
    ----------
    directory : Path
    manifest : dict
        The resolved config, its hash, versions, machine and times.
    """

    def __init__(self, directory: str | Path) -> None:
        from rattlesweep.sweeps.store.stored import open_stored

        self.directory = Path(directory)
        self._stored = open_stored(self.directory)
        self.manifest: dict[str, Any] = self._stored.manifest.dump()

    @property
    def runs(self) -> pd.DataFrame:
        """One row a run: the columns of ``runs/*.parquet``; no rows before the first block."""
        import pyarrow as pa

        store = self._stored.store
        tables = [store.read_block(index).table() for index in store.block_indices()]
        if not tables:
            tables = [self._stored.manifest.schema.empty_table()]
        frame: pd.DataFrame = pa.concat_tables(tables).to_pandas()
        return frame

    @property
    def summary(self) -> pd.DataFrame:
        """One row a case."""
        frame: pd.DataFrame = self._stored.store.read_summary().to_pandas()
        return frame

    def __repr__(self) -> str:
        """Name the directory and how far it is."""
        return f"<Sweep {self.directory}: {self.manifest['runs']} runs, {self.manifest['state']}>"


def load(directory: str | Path) -> Sweep:
    """Open an output directory.

    Raises
    ------
    ConfigError
        If it is none.

    Examples
    --------
    >>> import rattlesweep as rs
    >>> rs.load("out/steady").summary[["n_i", "fraction_R"]]  # doctest: +SKIP
    """
    return Sweep(directory)


def sweep(
    config: str | Path | Mapping[str, Any],
    *,
    output: str | Path | None = None,
    threads: int | None = None,
) -> Sweep:
    """Run a sweep, or go on with one that was stopped.

    Parameters
    ----------
    config : path or mapping
        A config file, or what one would hold.
    output : path, optional
        Output directory; overrides the config's.
    threads : int, optional
        Threads of the kernel.

    Returns
    -------
    Sweep

    Raises
    ------
    ConfigError, OutputError
        If the config is wrong, or the directory cannot be written.

    Warns
    -----
    ConfigWarning
        Of what makes little physical sense in the config, as ``rattlesweep run`` does.

    Examples
    --------
    >>> import rattlesweep as rs
    >>> rs.sweep("configs/quickstart.yaml").runs.t_r.describe()  # doctest: +SKIP
    """
    from rattlesweep.sweeps.config.load import load_config, parse_config
    from rattlesweep.sweeps.engines.run import run_sweep
    from rattlesweep.sweeps.sense.sense import checked_plan

    if isinstance(config, str | Path):
        loaded, base = load_config(config), Path(config).resolve().parent
    else:
        loaded, base = parse_config(config), None
    plan, doubts = checked_plan(loaded, base)
    for doubt in doubts:
        warnings.warn(doubt, ConfigWarning, stacklevel=2)
    directory = Path(output if output is not None else loaded.directory)
    run_sweep(plan, directory, base=base, threads=threads)
    return Sweep(directory)
