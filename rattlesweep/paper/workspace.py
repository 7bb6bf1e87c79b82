"""What all parts share: the directory of sweeps, sample counts, runs, drawing."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from ruamel.yaml import YAML

from rattlesweep import api
from rattlesweep.api import Trajectory
from rattlesweep.api.style import BLUE, thin
from rattlesweep.physics.body import Rattleback
from rattlesweep.system.files import probe_directory
from rattlesweep.words.errors import OutputError

# Tables by name, and those of all parts by part.
Tables = Mapping[str, pd.DataFrame]
Made = Mapping[str, Tables]

OMEGA_XY0 = 0.01  # of all launches of the figures of runs
LAUNCH = ["alpha", "beta", "gamma", "theta", "phi", "xi", "n_i", "omega_xy0", "psi"]


@dataclass(frozen=True)
class Sizes:
    """Sample counts and the length of a run; the defaults are the paper's, if any."""

    fig3_bodies: int = 1_000_000
    fig4_bodies: int = 100_000  # of (a)
    fig4_density: int = 100_000_000  # of (b)
    samples: int = 1000  # of each point of Figs. 6 to 8
    lyapunov: int = 20_000  # runs of type SW that are tested for chaos, at most
    windows: int = 6000  # runs of Fig. 8 that are followed in windows of time, at most
    friction: int = 1000  # bodies under friction
    pivoting: int = 400  # bodies under pivoting friction
    exponents_t_end: float = 1_000_000.0  # of the runs of Fig. 9


FULL_SIZES = Sizes()
QUICK_SIZES = Sizes(
    fig3_bodies=50_000,
    fig4_density=2_000_000,
    samples=30,
    lyapunov=200,
    friction=60,
    pivoting=40,
    exponents_t_end=50_000.0,
)


class Workspace:
    """An output directory whose sweeps resume; the rest is computed each time."""

    def __init__(
        self, directory: Path, sizes: Sizes = FULL_SIZES, **settings: Any
    ) -> None:
        """Create or open the directory, with `threads` and `progress` of its sweeps."""
        probe_directory(directory)
        self.directory = directory
        self.sizes = sizes
        self.settings = settings
        self.failed = 0
        self._sweeps: dict[str, pd.DataFrame] = {}

    def sweep(self, name: str) -> pd.DataFrame:
        """Run or resume the sweep ``sweeps/NAME``; return its runs of status ``ok``."""
        if name not in self._sweeps:
            config = sweep_config(name, self.sizes)
            output = self.directory / "sweeps" / name
            sweep = api.sweep(config, output=output, **self.settings)
            runs = self._good(sweep.read())
            cases = sweep.summary.set_index("case")
            for target in map(str, cases[["K_p", "K_r"]].dropna(axis=1, how="all")):
                targets = runs["case"].map(cases[target])
                runs = runs.assign(**{f"{target}_body": runs[target], target: targets})
            self._sweeps[name] = runs.reset_index(drop=True)
        return self._sweeps[name]

    def again(self, runs: pd.DataFrame, most: int, *record: str) -> pd.DataFrame:
        """Integrate runs once more with ``record``, or `most`, evenly chosen."""
        runs = runs.iloc[:: max(1, -(-len(runs) // most))]
        if runs.empty:
            return runs
        again = api.simulate(runs[LAUNCH], **self.settings, record=record)
        return self._good(again).reindex(runs.index)

    def _good(self, runs: pd.DataFrame) -> pd.DataFrame:
        good = runs["status"] == "ok"
        self.failed += int((~good).sum())
        return runs[good]


def sweep_config(name: str, sizes: Sizes) -> dict[str, Any]:
    """Return the config of ``steady``, ``unsteady``, ``friction`` or ``pivoting``."""
    config: dict[str, Any] = YAML(typ="safe").load(
        Path(__file__).with_name(f"{name}.yaml")
    )
    samples = {"friction": sizes.friction, "pivoting": sizes.pivoting}
    config["bodies"]["samples"] = samples.get(name, sizes.samples)
    return config


def follow_run(
    body: Rattleback, *channels: str, dt: float = 0.05, **launch: Any
) -> Trajectory:
    """Integrate one run past its reversals; raise OutputError if it fails."""
    run = api.trajectory(body, channels=("t", *channels), dt=dt, **launch)
    if run.status != "ok":
        raise OutputError(
            f"{body}: the run ended at t = {run.t_end:g} with {run.status}"
        )
    return run


def thinned(run: pd.DataFrame, *beside: str, **bins: int) -> pd.DataFrame:
    """Return ``t`` and columns of a run at the rows that a curve needs."""
    places = [thin(run[name].to_numpy(), number) for name, number in bins.items()]
    rows = run.iloc[np.unique(np.concatenate(places))]
    return rows[["t", *beside, *bins]].reset_index(drop=True)


def draw_spin(
    axis: Axes, series: pd.DataFrame, linewidth: float = 0.8, label: str = ""
) -> None:
    """Draw the spin against time, and a line at zero if it reverses."""
    axis.plot(series["t"], series["n"], color=BLUE, linewidth=linewidth, label=label)
    if series["n"].min() < 0 < series["n"].max():
        axis.axhline(0, color="#777777", linewidth=0.6, zorder=1)
    axis.set(xlabel=r"$t$ / $\tilde t$", ylabel=r"$n$ / $\tilde\omega$")


def records(frame: pd.DataFrame) -> list[dict[str, Any]]:
    """Return the rows of a table as dictionaries."""
    rows: list[Any] = frame.to_dict("records")
    return rows
