"""What all parts share: the output directory, its sweeps, the numbers of samples."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd
from matplotlib.figure import Figure
from ruamel.yaml import YAML

from rattlesweep import api
from rattlesweep.sweeps.files import probe_directory

# Tables by name, and those of all parts by part.
Tables = Mapping[str, pd.DataFrame]
Made = Mapping[str, Tables]

LAUNCH = ["alpha", "beta", "gamma", "theta", "phi", "xi", "n_i", "omega_xy0", "psi"]


@dataclass(frozen=True)
class Sizes:
    """Numbers of samples and one length; the defaults are the paper's where it has any."""

    fig3_bodies: int = 1_000_000
    fig4_bodies: int = 100_000  # of (a)
    fig4_density: int = 100_000_000  # of (b)
    samples: int = 1000  # of each point of Figs. 6 to 8
    lyapunov: int = 20_000  # most runs of type SW that are tried for chaos
    windows: int = 6000  # most runs of Fig. 8 that are followed in windows of time
    friction: int = 1000  # bodies under friction
    exponents_t_end: float = 200_000.0  # of the runs of Fig. 9


FULL = Sizes()
QUICK = Sizes(
    fig3_bodies=50_000,
    fig4_density=2_000_000,
    samples=30,
    lyapunov=200,
    friction=60,
    exponents_t_end=50_000.0,
)


class Workspace:
    """An output directory whose sweeps resume; all else takes seconds and is computed anew."""

    def __init__(
        self,
        directory: Path,
        sizes: Sizes = FULL,
        threads: int | None = None,
        progress: bool | None = None,
    ) -> None:
        probe_directory(directory)
        self.directory, self.sizes = directory, sizes
        self.settings: dict[str, Any] = {"threads": threads, "progress": progress}
        self.failed = 0
        self._sweeps: dict[str, pd.DataFrame] = {}

    def sweep(self, name: str, config: Mapping[str, Any] | None = None) -> pd.DataFrame:
        """Run the sweep ``sweeps/NAME``, or go on with it, and return its runs that are ``ok``."""
        if name not in self._sweeps:
            path = self.directory / "sweeps" / name
            config = config or sweep_config(name, self.sizes)
            found = api.sweep(config, output=path, **self.settings)
            runs, cases = self._good(found.read()), found.summary.set_index("case")
            for target in ("K_p", "K_r"):
                if cases[target].notna().any():
                    targets = runs["case"].map(cases[target])
                    runs = runs.assign(**{f"{target}_body": runs[target], target: targets})
            self._sweeps[name] = runs.reset_index(drop=True)
        return self._sweeps[name]

    def again(self, runs: pd.DataFrame, **how: Any) -> pd.DataFrame:
        """Integrate runs once more with other arguments of :func:`rattlesweep.simulate`."""
        if runs.empty:
            return pd.DataFrame(index=runs.index)
        found = self._good(api.simulate(runs[LAUNCH], **self.settings, **how))
        return found.reindex(runs.index)

    def _good(self, runs: pd.DataFrame) -> pd.DataFrame:
        good = runs["status"] == "ok"
        self.failed += int((~good).sum())
        return runs[good]


@dataclass(frozen=True)
class Part:
    """A figure of the paper, or a supplement to one: words for people, its data, its picture."""

    title: str
    data: Callable[[Workspace], Tables]
    caption: str = ""
    draw: Callable[[Tables], Figure] | None = None


def sweep_config(name: str, sizes: Sizes) -> dict[str, Any]:
    """Return the config of the sweep ``steady`` or ``unsteady``, that of ``configs/``."""
    config: dict[str, Any] = YAML(typ="safe").load(Path(__file__).with_name(f"{name}.yaml"))
    config["bodies"]["samples"] = sizes.samples
    return config


def evenly(runs: pd.DataFrame, most: int) -> pd.DataFrame:
    """Return at most so many of the runs, evenly chosen, so that all cases keep their share."""
    return runs.iloc[:: max(1, -(-len(runs) // most))]


def records(frame: pd.DataFrame) -> list[dict[str, Any]]:
    """Return the rows of a table, each by the names of its columns."""
    rows: list[Any] = frame.to_dict("records")
    return rows
