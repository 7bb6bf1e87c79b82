"""Sweeps: run them, and open those that were run."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rattlesweep.api.arrays import check_threads, is_frame
from rattlesweep.api.stored import Sweep
from rattlesweep.errors import ConfigError, ConfigWarning
from rattlesweep.progress import Bar

if TYPE_CHECKING:
    import pandas as pd

    from rattlesweep.sweeps.plan import Plan


def load(directory: str | Path) -> Sweep:
    """Open an output directory.

    Parameters
    ----------
    directory : path
        Of a sweep, whole or still running.

    Returns
    -------
    Sweep

    Examples
    --------
    >>> import rattlesweep as rs
    >>> rs.load("out/gh").summary[["n_i", "fraction_R"]]
       n_i  fraction_R
    0  0.1         1.0
    1 -0.1         1.0
    """
    return Sweep(directory)


def sweep(
    config: str | Path | Mapping[str, Any] | pd.DataFrame,
    *,
    output: str | Path | None = None,
    threads: int | None = None,
    progress: bool | None = None,
    **keys: Any,
) -> Sweep:
    """Run a sweep, or go on with one that was stopped.

    Parameters
    ----------
    config : path, mapping or DataFrame
        A config file; what one would hold; or bodies, with the columns ``alpha beta gamma theta phi
        xi`` and perhaps ``n_i omega_xy0 psi t_end``, as in a table of bodies (angles in radians).
        Bodies are kept in the output directory beside their runs.
    output : path, optional
        Output directory; overrides the config's.
    threads : int, optional
        Threads of the kernel; by default one for each processor.
    progress : bool, optional
        Whether to show a bar; by default in a terminal and in a notebook, if it takes long.
    **keys
        For a DataFrame, the other keys of the config: ``spin``, ``horizon``, ``record`` ...

    Returns
    -------
    Sweep

    Warns
    -----
    ConfigWarning
        Of what makes little physical sense in the config, as ``rattlesweep run`` does.

    Examples
    --------
    >>> import rattlesweep as rs
    >>> sweep = rs.sweep("configs/gh.yaml")
    >>> sweep.runs.t_r.round(2).tolist()
    [112.09, 809.86]
    >>> bodies = sweep.read(["alpha", "beta", "gamma", "theta", "phi", "xi"])
    >>> again = rs.sweep(bodies, output="out/again", spin={"n_i": [0.2], "omega_xy0": 0.1})
    >>> again.runs.t_r.round(2).tolist()
    [33.15, 33.15]
    """
    from rattlesweep.integrate.compile import listening
    from rattlesweep.sweeps.run import run_sweep

    check_threads(threads)
    target = None if output is None else Path(output)
    plan, target, base, doubts = _planned(config, target, keys)
    for doubt in doubts:
        warnings.warn(doubt, ConfigWarning, stacklevel=2)
    with Bar.of_call(progress) as bar, listening(bar.compiling):
        run_sweep(plan, target, base=base, threads=threads, report=bar)
    return Sweep(target)


def _planned(
    config: Any, output: Path | None, keys: Mapping[str, Any]
) -> tuple[Plan, Path, Path | None, list[str]]:
    """The plan of a sweep, where it goes, where its table is looked for, and what is doubtful."""
    from rattlesweep.sweeps.config.read import load_config, parse_config
    from rattlesweep.sweeps.plausible import checked_plan

    base: Path | None = None
    if is_frame(config):
        from rattlesweep.sweeps.frame import plan_frame

        return plan_frame(config, output, keys)
    if keys:
        raise ConfigError(
            f"{next(iter(keys))}: is given beside a config; write it into the config, as only a "
            "DataFrame of bodies has its keys beside it"
        )
    if isinstance(config, str | Path):
        loaded, base = load_config(config), Path(config).resolve().parent
    else:
        loaded = parse_config(config)
    plan, doubts = checked_plan(loaded, base)
    return plan, output or Path(loaded.directory), base, doubts
