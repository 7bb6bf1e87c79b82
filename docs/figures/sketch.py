"""Draw the symbols of a rattleback: from above, and from the side.

    python docs/figures/sketch.py [docs]

The skew is drawn four times as large as that of a usual stone.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from matplotlib.patches import Arc, Circle, Ellipse, Polygon

SKEW = np.radians(14)  # -xi
STONE = "#e9dfcc"
EDGE = "#6b5b45"
INERTIA = "#1f5a96"
CURVATURE = "#a33b20"
UNSTEADY = "#a33b20"
STEADY = "#2e6e3f"
TEXT = 13


def arrow(
    axes: Axes, start: object, end: object, colour: str, width: float = 1.6
) -> None:
    """Draw an arrow between two points."""
    style = {"arrowstyle": "-|>", "color": colour, "lw": width, "mutation_scale": 15}
    axes.annotate("", end, start, arrowprops=style | {"shrinkA": 0, "shrinkB": 0})


def turning(
    axes: Axes, radius: float, start: float, end: float, colour: str, label: str
) -> None:
    """Draw an arrow that turns about the middle, from one angle to another (deg)."""
    angle = np.radians(np.linspace(start, end, 60))
    x = radius * np.cos(angle)
    y = 0.62 * radius * np.sin(angle)
    axes.plot(x[:-3], y[:-3], color=colour, lw=2.6)
    arrow(axes, (x[-4], y[-4]), (x[-1], y[-1]), colour, 2.6)
    axes.text(x[-1], 2.0, label, color=colour, fontsize=TEXT, ha="center", va="bottom")


def from_above(axes: Axes) -> None:
    """Draw the axes, the skew and the two directions of spin."""
    axes.add_patch(Ellipse((0, 0), 4.0, 1.3, fc=STONE, ec=EDGE, lw=1.6))
    for side in (-1, 1):
        axes.add_patch(Circle((1.25 * side, -0.29 * side), 0.17, fc="#b9a06a", ec=EDGE))
    axes.plot([-2.5, 2.5], [0, 0], "--", color=CURVATURE, lw=1.3)
    axes.plot([0, 0], [-0.95, 0.95], "--", color=CURVATURE, lw=1.3)
    axes.text(-2.55, -0.1, r"$\phi/a$", color=CURVATURE, fontsize=TEXT, va="top")
    axes.text(0.08, -1.0, r"$\theta/a$", color=CURVATURE, fontsize=TEXT, va="top")

    along = np.array([np.cos(SKEW), -np.sin(SKEW)])
    across = np.array([np.sin(SKEW), np.cos(SKEW)])
    arrow(axes, -2.3 * along, 2.45 * along, INERTIA)
    arrow(axes, -0.85 * across, 1.0 * across, INERTIA)
    axes.text(*(2.52 * along), "$y$", color=INERTIA, fontsize=TEXT + 2, va="center")
    axes.text(*(1.08 * across), "$x$", color=INERTIA, fontsize=TEXT + 2, ha="center")
    degrees = np.degrees(SKEW)
    axes.add_patch(
        Arc((0, 0), 3.5, 3.5, theta1=-degrees, theta2=0, color="black", lw=1.4)
    )
    axes.text(1.86, -0.22, r"$|\xi|$", fontsize=TEXT + 1, va="center")

    turning(axes, 2.75, 97, 125, UNSTEADY, "unsteady: $n > 0$\nturns back soon")
    turning(axes, 2.75, 83, 55, STEADY, "steady: $n < 0$\nturns back late, or never")
    axes.set(xlim=(-2.95, 2.95), ylim=(-1.6, 2.7), aspect="equal")
    axes.set_title("from above", fontsize=TEXT)
    axes.axis("off")


def from_the_side(axes: Axes) -> None:
    """Draw the centre of mass, the contact and the vertical, for a tilted body."""
    tilt = np.radians(9)
    half_length = 2.3
    top = 0.35  # above the centre of mass
    y = np.linspace(-half_length, half_length, 400)
    bottom = top - 1.35 * np.sqrt(1 - (y / half_length) ** 2)
    turn = np.array([[np.cos(tilt), -np.sin(tilt)], [np.sin(tilt), np.cos(tilt)]])
    outline = np.concatenate([[y, bottom], [y[::-1], np.full(len(y), top)]], axis=1)
    outline = turn @ outline
    lowest = outline[:, np.argmin(outline[1])]
    axes.add_patch(Polygon(outline.T, fc=STONE, ec=EDGE, lw=1.6))
    axes.plot([-2.7, 2.7], [lowest[1]] * 2, color="black", lw=1.6)

    axes.plot(0, 0, "o", color="black", ms=6)
    axes.text(0.1, 0.1, "G", fontsize=TEXT)
    axes.plot(*lowest, "o", color="black", ms=4)
    down = turn @ np.array([0.0, -1.0])
    arrow(axes, (0, 0), 1.6 * down, INERTIA)
    axes.text(
        *(1.75 * down),
        "$z$",
        color=INERTIA,
        fontsize=TEXT + 2,
        ha="center",
        va="center",
    )
    axes.text(*(0.5 * down + [0.09, 0.0]), "$a$", fontsize=TEXT + 1, va="center")
    arrow(axes, (0, 0), lowest, "black", 1.3)
    axes.text(*(0.55 * lowest + [-0.26, 0.0]), "$r$", fontsize=TEXT + 1, va="center")
    arrow(axes, (0, 0), (0, 1.35), CURVATURE)
    axes.text(
        0.12,
        1.25,
        r"$u$, upward:  $n = u \cdot \omega$",
        fontsize=TEXT,
        color=CURVATURE,
    )
    axes.text(
        2.7,
        lowest[1] - 0.12,
        "rolls, does not slip",
        fontsize=TEXT - 1,
        ha="right",
        va="top",
    )
    axes.set(xlim=(-2.9, 2.9), ylim=(-1.9, 1.7), aspect="equal")
    axes.set_title("from the side, tilted", fontsize=TEXT)
    axes.axis("off")


folder = Path(sys.argv[1] if len(sys.argv) > 1 else "docs")
for name, draw in (("above", from_above), ("side", from_the_side)):
    figure, panel = plt.subplots(figsize=(5.7, 4.3), layout="constrained")
    draw(panel)
    figure.savefig(folder / f"sketch_{name}.png", dpi=110, bbox_inches="tight")
