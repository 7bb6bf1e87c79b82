"""What all parts share: the directory of sweeps, sample counts, runs, drawing."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from ruamel.yaml import YAML

from rattlesweep import api
from rattlesweep.api import Trajectory
from rattlesweep.api.style import BLUE, chosen_size, new_figure, thin
from rattlesweep.config.read import overridden
from rattlesweep.physics.body import Rattleback
from rattlesweep.system.files import probe_directory
from rattlesweep.words.errors import ConfigError, OutputError

# Tables by name, and those of all parts by part.
Tables = Mapping[str, pd.DataFrame]
Made = Mapping[str, Tables]

# Ranges of the random bodies SD (Table I).
TABLE_I = {
    "gamma": (5.0, 15.0),
    "f_sd": (0.05, 0.15),
    "theta": (0.6, 0.95),
    "phi": (0.01, 0.1),
    "minus_xi_deg": (0.0, 6.0),
}
# What may be overridden: the figures have the paper's launches.
SETTABLE = ("bodies.ranges.", "bodies.c", "integrator.")
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
        self,
        directory: Path,
        sizes: Sizes = FULL_SIZES,
        overrides: Sequence[str] = (),
        **settings: Any,
    ) -> None:
        """Create or open the directory, with `threads` and `progress` of its sweeps.

        `overrides` are texts such as ``bodies.ranges.theta=[0.7, 0.8]``.
        """
        self.overrides = tuple(overrides)
        self.sizes = sizes
        # A mistake in them is told before anything is written.
        bodies = self.config("steady")["bodies"]
        self.ranges = TABLE_I | bodies.get("ranges", {})
        probe_directory(directory)
        self.directory = directory
        self.settings = settings
        self.failed = 0
        self._sweeps: dict[str, pd.DataFrame] = {}

    def sweep(self, name: str) -> pd.DataFrame:
        """Run or resume the sweep ``sweeps/NAME``; return its runs of status ``ok``."""
        if name not in self._sweeps:
            config = self.config(name)
            output = self.directory / "sweeps" / name
            sweep = api.sweep(config, output=output, **self.settings)
            runs = self._good(sweep.read())
            cases = sweep.summary.set_index("case")
            for target in map(str, cases[["K_p", "K_r"]].dropna(axis=1, how="all")):
                targets = runs["case"].map(cases[target])
                runs = runs.assign(**{f"{target}_body": runs[target], target: targets})
            self._sweeps[name] = runs.reset_index(drop=True)
        return self._sweeps[name]

    def config(self, name: str) -> dict[str, Any]:
        """Return the config of a sweep."""
        return sweep_config(name, self.sizes, self.overrides)

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


def sweep_config(
    name: str, sizes: Sizes, overrides: Sequence[str] = ()
) -> dict[str, Any]:
    """Return the config of ``steady``, ``unsteady``, ``friction`` or ``pivoting``."""
    for text in overrides:
        if not text.strip().startswith(SETTABLE):
            raise ConfigError(
                f"--set {text}: the figures have the launches of the paper; set the "
                "ranges or the surface of bodies, as in bodies.ranges.theta=[0.7, 0.8] "
                "or bodies.c=2, or the integrator, as in integrator.tol=1e-11"
            )
    config: dict[str, Any] = YAML(typ="safe").load(
        Path(__file__).with_name(f"{name}.yaml")
    )
    samples = {"friction": sizes.friction, "pivoting": sizes.pivoting}
    config["bodies"]["samples"] = samples.get(name, sizes.samples)
    return overridden(config, overrides)


def paper_figure(width: float, height: float) -> Figure:
    """Return a figure of the size that the caller or a style asks for, or of this."""
    return new_figure(*(chosen_size() or (width, height)))


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
