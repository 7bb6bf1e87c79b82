"""Draw the chart of regimes, and sections of two attractors at one of its points.

    rattlesweep run configs/chart.yaml
    python docs/figures/chart.py out/chart [docs/chart.png]

The attractors are those of docs/literature.md at an energy of 6.52.
"""

from __future__ import annotations

import sys

import numpy as np
from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.patches import Patch

import rattlesweep as rs
from rattlesweep.analysis.layout import Axis, fill
from rattlesweep.analysis.style import INK, REGIME_STYLE
from rattlesweep.words.names import REGIMES

DELTA = 0.485
BODY = rs.Rattleback(7, 3, 7, 1 / 4, 1 / 9, -DELTA)
ENERGY = 6.52
# The section is u_y = 0, rising, and omega_y = 0, rising.
LORENZ = ((-1.021362, -1.188334, -0.279498), (0.291523, 0.163116, -0.942554))
LARGE = ((0.239443, -1.22271, 0.825371), (0.188817, -0.19839, -0.961764))
SETTLED = 2_000.0
T_END = 200_000.0


def edges(values: np.ndarray) -> np.ndarray:
    """Return the edges of cells around values."""
    return Axis("", values, np.arange(len(values))).edges


def draw_chart(axes: Axes, directory: str) -> None:
    """Colour the regimes over skew angle and energy."""
    sweep = rs.load(directory)
    data = sweep.to_xarray(["regime", "energy_0"]).squeeze()
    data = data.transpose("minus_xi_deg", "omega_xy0")
    code = np.full(data.regime.shape, -1)
    for number, name in enumerate(REGIMES):
        code[(data.regime == name).to_numpy()] = number
    code = fill(code, code >= 0)
    skew = data.minus_xi_deg.to_numpy()
    energy = data.energy_0.max("minus_xi_deg").interpolate_na("omega_xy0").to_numpy()
    colours = [REGIME_STYLE[name].colour for name in REGIMES]
    axes.pcolormesh(
        edges(skew),
        edges(energy),
        code.T,
        cmap=ListedColormap(colours),
        vmin=-0.5,
        vmax=len(REGIMES) - 0.5,
        rasterized=True,
    )
    axes.plot(np.degrees(DELTA), ENERGY, "o", color="white", markeredgecolor=INK)
    axes.set(xlabel="skew angle $-\\xi$ (degrees)", ylabel="energy ($M g a$)")
    present = [name for number, name in enumerate(REGIMES) if number in code]
    entries = [
        Patch(color=REGIME_STYLE[name].colour, label=REGIME_STYLE[name].label)
        for name in present
    ]
    axes.legend(
        handles=entries, loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2
    ).set_frame_on(False)
    for name in present:
        share = (code == REGIMES.index(name)).mean()
        print(f"{name}: {share:.1%} of the chart")
    print(f"{len(sweep.read(['case'])):,} runs")


def draw_section(axes: Axes, launch: tuple, section: str, x: str, y: str) -> None:
    """Draw a section of the motion after its launch has been forgotten."""
    omega, u = launch
    path = rs.trajectory(
        BODY,
        omega=omega,
        u=u,
        t_end=T_END,
        section=section,
        channels=("t", x, y),
        from_time=SETTLED,
    )
    points = path.section
    print(f"{section}: {len(points):,} crossings")
    axes.plot(points[x], points[y], ",", color=INK, alpha=0.5, rasterized=True)
    symbols = {"u_x": "$u_x$", "u_y": "$u_y$", "n": "spin $n$"}
    axes.set(xlabel=symbols[x], ylabel=symbols[y])


figure = plt.figure(figsize=(9, 5.4), layout="constrained")
left, right = figure.subfigures(1, 2, width_ratios=(1.7, 1))
draw_chart(left.subplots(), sys.argv[1])
upper, lower = right.subplots(2, 1)
draw_section(upper, LORENZ, "u_y=0+", "u_x", "n")
upper.set_title("Lorenz-like attractor", fontsize="medium")
draw_section(lower, LARGE, "omega_y=0+", "u_x", "u_y")
lower.set_title("the other attractor there", fontsize="medium")
figure.savefig(sys.argv[2] if len(sys.argv) > 2 else "docs/chart.png", dpi=130)
