"""How often a body of Garcia and Hubbard's reverses before it is at rest, over damping and skew.

    python docs/figure_damping.py [docs/damping.png]
    python docs/figure_damping.py stone

The body of configs/reversals.yaml, one sweep for each sigma.  The second prints reversals of a
stone of 12 x 3 x 1.2 cm with rolling resistance.
"""

from __future__ import annotations

import sys
import tempfile
import warnings
from collections.abc import Mapping
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import yaml
from matplotlib import colormaps
from matplotlib import pyplot as plt
from matplotlib.colors import BoundaryNorm, ListedColormap

import rattlesweep as rs
from rattlesweep.errors import ConfigWarning
from rattlesweep.study.plots.map import NO_REVERSAL
from rattlesweep.study.style import THEORY

CONFIG = Path(__file__).parents[1] / "configs" / "reversals.yaml"
SIGMA = np.geomspace(3e-4, 0.3, 31)
SPINS = {0.2: "unsteady direction", -0.2: "steady direction"}
# A spin that counts holds a sixteenth of the first energy.  Rocking loses the least, its energy at
# the rate sigma/(1 + alpha): behind this time, over sigma, exp(-60/14) of it is left.
LIFE = 60.0
BORDERS = (0, 1, 2, 3, 4, 5, 6, 8, 11, 16, 32, 64, 128, 256)


def swept(config: Mapping[str, Any], columns: list[str]) -> pd.DataFrame:
    """Runs of one sweep."""
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
        warnings.simplefilter("ignore", ConfigWarning)  # t_rgh is beyond some horizons
        return rs.sweep(config, output=Path(folder) / "out").read(columns=columns)


def damped() -> pd.DataFrame:
    """Numbers of reversals of all skews, both directions and all sigma."""
    plain, parts = yaml.safe_load(CONFIG.read_text()), []
    for sigma in SIGMA:
        config = plain | {
            "spin": plain["spin"] | {"n_i": list(SPINS)},
            "horizon": {"t": float(LIFE / sigma)},
            "dissipation": {"sigma": float(sigma)},
        }
        parts.append(swept(config, ["sigma", "n_i", "xi", "n_reversals", "energy_left", "growth"]))
    return pd.concat(parts).assign(skew=lambda runs: -np.degrees(runs.xi))


def draw(target: str) -> None:
    """The map, and what the page says of it."""
    runs = damped()
    print(f"energy left at the horizon: at most {runs.energy_left.max():.2g} of the first")
    most = runs.n_reversals.max()
    borders = [*(b for b in BORDERS if b <= most), most + 1]
    shades = colormaps["viridis"](np.linspace(0.1, 1, len(borders) - 2))
    norm = BoundaryNorm(np.array(borders) - 0.5, len(borders) - 1)
    figure, panels = plt.subplots(1, 2, figsize=(8.6, 4.2), sharey=True, layout="constrained")
    for axes, (n_i, direction) in zip(panels, SPINS.items(), strict=True):
        table = runs[runs.n_i == n_i].pivot_table(
            index="skew", columns="sigma", values=["n_reversals", "growth"]
        )
        count, growth = table["n_reversals"], table["growth"]
        mesh = axes.pcolormesh(count.columns, count.index, count, norm=norm, rasterized=True,
                               cmap=ListedColormap([NO_REVERSAL, *shades]))  # fmt: skip
        axes.contour(growth.columns, growth.index, growth, [0], colors=[THEORY["color"]],
                     linestyles=["--"], linewidths=1.2)  # fmt: skip
        axes.set(xscale="log", yscale="log", xlabel=r"$\sigma$ ($M a^2 \sqrt{g/a}$)",
                 title=rf"$n_i$ = {n_i:g}, {direction}")  # fmt: skip
        for skew in (1.0, 2.0, 5.0, 10.0):
            row = count.loc[count.index[np.argmin(np.abs(count.index.to_numpy() - skew))]]
            ranges = [f"{number}: {s.index.min():.2g} to {s.index.max():.2g}"
                      for number, s in row.groupby(row.astype(int)) if number <= 8]  # fmt: skip
            print(f"{direction}, {row.name:.2f} degrees, up to {row.max():.0f};", ", ".join(ranges))
    panels[0].set_ylabel("skew (degrees)")
    panels[1].plot([], [], color=THEORY["color"], linestyle="--", linewidth=1.2,
                   label="growth at the launch\nbalances damping")  # fmt: skip
    panels[1].legend(frameon=False, loc="lower right")
    bar = figure.colorbar(mesh, ax=panels, pad=0.02, aspect=30)
    steps = list(pairwise(borders))
    names = [str(a) if b == a + 1 else f"{a} to {b - 1}" for a, b in steps]
    bar.set_ticks([(a + b - 1) / 2 for a, b in steps], labels=names)
    bar.ax.tick_params(which="both", length=0)
    bar.set_label("number of reversals")
    figure.savefig(target, dpi=130)


def stone() -> None:
    """Reversals of half an ellipsoid of 12 x 3 x 1.2 cm, uniform, its mass turned by 8 degrees."""
    p, q, c = 0.06, 0.015, 0.012
    up = 3 * c / 8  # from the flat top down to the centre of mass
    x, y, z = (q * q + c * c) / 5 - up**2, (p * p + c * c) / 5 - up**2, (p * p + q * q) / 5
    radii, angle = (p * p / c, q * q / c), np.radians(-8)
    body = rs.Rattleback.from_si(
        mass=1, inertia=(x, y, z), height=c - up, radii=radii, axes_angle=angle, c=c
    )
    assert body.units is not None
    print(body, f"{body.units.time:.5f} s")
    names = ("alpha", "beta", "gamma", "theta", "phi", "xi")
    for micrometres in (0, 20, 50, 100):
        found = {}
        for seconds in (360, 720):
            config = {
                "bodies": {
                    "source": "grid",
                    "base": {name: getattr(body, name) for name in names},
                    "surface": "ellipsoid",
                    "axes": {"c": [body.c]},
                },
                "spin": {"n_i": [0.1, 0.2, 0.4, -0.1, -0.2, -0.4], "omega_xy0": [0.01, 0.1]},
                "horizon": {"t": float(seconds / body.units.time)},
                "dissipation": {"rolling": float(micrometres * 1e-6 / (c - up))},
                "record": ["reversals"],
            }
            runs = swept(config, ["n_i", "omega_xy0", "n_reversals"])
            found[f"{seconds} s"] = runs.pivot_table("n_reversals", "omega_xy0", "n_i")
        print(f"{micrometres} um", pd.concat(found), sep="\n")


if __name__ == "__main__":
    if sys.argv[1:] == ["stone"]:
        stone()
    else:
        draw(sys.argv[1] if len(sys.argv) > 1 else "docs/damping.png")
