"""A mesh at rest from three sides, and the part of its bottom that was fitted."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure

from rattlesweep.analysis import room, style
from rattlesweep.analysis.derived import DerivedQuantity
from rattlesweep.analysis.style import BLUE, GREY, INK, VERMILION
from rattlesweep.arrays import Floats
from rattlesweep.physics.mesh.reading import read_solid, read_standing
from rattlesweep.physics.mesh.solid import Solid
from rattlesweep.physics.mesh.standing import Standing
from rattlesweep.words.defaults import MESH_UNIT

# Views: name, the two axes of the mesh at rest that are seen, labels, and the sign of
# the third one, on which the viewer is.
_VIEWS = (
    ("from above", (0, 1), ("x", "y"), 2, 1.0),
    ("from the side", (0, 2), ("x", "z"), 1, -1.0),
    ("from the end", (1, 2), ("y", "z"), 0, 1.0),
)
_PALE = np.array([0.93, 0.92, 0.90])
_DARK = np.array([0.45, 0.45, 0.45])
_MOST_DRAWN = 60_000  # facets of a view
_MOST_DOTS = 4000


def save_figure_of_mesh(
    path: Path,
    keys: Mapping[str, Any],
    quantities: Mapping[str, DerivedQuantity],
) -> None:
    """Draw a mesh from the arguments of :meth:`Rattleback.from_mesh`, with `mesh`."""
    others = dict(keys)
    file = others.pop("mesh")
    standing = read_standing(file, **others)
    solid = read_solid(file, others.get("unit", MESH_UNIT))
    with style.styled():
        figure = draw_mesh(solid, standing, quantities)
        figure.suptitle(Path(file).name, fontsize=10)
        room.fit_to_size(figure)
        style.save_figure(figure, [path])


def draw_mesh(
    solid: Solid,
    standing: Standing,
    quantities: Mapping[str, DerivedQuantity],
) -> Figure:
    """Return a figure of a mesh at rest, the fitted patch, and what follows from it.

    Lengths are in mm from the foot of the body, z upwards.
    """
    figure = room.usual_figure(9.6, 6.6)
    grid = figure.add_gridspec(2, 3, height_ratios=[1, 1.6])
    local = (solid.vertices - standing.mass.centre) @ standing.axes.T
    local[:, 2] += standing.height
    local = local * 1e3
    corners = local[solid.faces]
    for column, view in enumerate(_VIEWS):
        axes = figure.add_subplot(grid[0, column])
        _draw_view(axes, corners, standing, view)
    _draw_patch(figure, figure.add_subplot(grid[1, :2]), standing)
    _write_values(figure.add_subplot(grid[1, 2]), standing, quantities)
    return figure


def _draw_view(
    axes: Axes,
    corners: Floats,
    standing: Standing,
    view: tuple[str, tuple[int, int], tuple[str, str], int, float],
) -> None:
    name, seen, labels, hidden, side = view
    edges = corners[:, 1:] - corners[:, :1]
    normals = np.cross(edges[:, 0], edges[:, 1])
    sizes = np.linalg.norm(normals, axis=1)
    facing = side * normals[:, hidden] / np.where(sizes > 0, sizes, 1.0)
    front = np.flatnonzero(facing > 0)
    # Facets of a fine mesh are smaller than pixels, so that larger ones stand for all.
    if len(front) > _MOST_DRAWN:
        front = front[np.argsort(sizes[front])[::-1][:_MOST_DRAWN]]
    depth = side * corners[front, :, hidden].mean(axis=1)
    front = front[np.argsort(depth)]
    shades = _DARK + facing[front, None] * (_PALE - _DARK)
    outlines = corners[front][:, :, list(seen)]
    facets = PolyCollection(
        list(outlines), facecolors=shades, edgecolors=shades, linewidths=0.3,
        rasterized=True,
    )  # fmt: skip
    axes.add_collection(facets)
    axes.set_aspect("equal")
    axes.autoscale_view()
    axes.set_title(name, fontsize=9)
    axes.set_xlabel(f"{labels[0]} / mm")
    axes.set_ylabel(f"{labels[1]} / mm")
    if hidden == 2:
        _draw_axes(axes, standing, float(np.ptp(corners[..., 0])) / 2)
    else:
        axes.axhline(0.0, color=INK, linewidth=0.8)
        axes.plot(0.0, standing.height * 1e3, "o", color=INK, markersize=3)
    axes.plot(0.0, 0.0, "+", color=INK, markersize=5)


def _draw_axes(axes: Axes, standing: Standing, size: float) -> None:
    """Draw the principal axes of inertia and of curvature through the middle."""
    _, directions = np.linalg.eigh(standing.surface.curvature)
    _, turned = np.linalg.eigh(standing.inertia[:2, :2])
    pairs = (
        (turned[:, 0], GREY, "-", "axis of inertia"),
        (directions[:, 0], VERMILION, "--", "axis of curvature"),
    )
    for direction, colour, dashes, label in pairs:
        x, y = 1.08 * size * direction
        axes.plot([-x, x], [-y, y], dashes, color=colour, linewidth=1.1, label=label)
    axes.legend(fontsize=7.5, loc="upper center", bbox_to_anchor=(0.5, -0.55), ncols=2)


def _draw_patch(figure: Figure, axes: Axes, standing: Standing) -> None:
    """Draw the points that were fitted, coloured by their residuals."""
    surface = standing.surface
    points = standing.points[surface.fitted] * 1e3
    residuals = surface.residuals * 1e6
    step = max(1, len(points) // _MOST_DOTS)
    most = float(np.abs(residuals).max()) or 1.0
    dots = axes.scatter(
        points[::step, 0], points[::step, 1], c=residuals[::step], s=6,
        cmap="RdBu_r", vmin=-most, vmax=most, edgecolors=GREY, linewidths=0.08,
        rasterized=True,
    )  # fmt: skip
    figure.colorbar(dots, ax=axes, label="mesh above the fit / um", shrink=0.85)
    # The outline of the fitted quadric at the height up to which it is fitted.
    _, directions = np.linalg.eigh(surface.curvature)
    rise = surface.reach - surface.k * surface.reach**2 / 2
    half = np.sqrt(2 * rise * surface.radii[::-1]) * 1e3
    turn = np.linspace(0, 2 * math.pi, 181)
    outline = directions @ (half[:, None] * np.array([np.cos(turn), np.sin(turn)]))
    axes.plot(*outline, color=BLUE, linewidth=0.9)
    axes.plot(0.0, 0.0, "+", color=INK)
    slope = math.degrees(float(standing.slopes[0]))
    axes.set_title(
        f"fitted: the lowest {surface.reach * 1e3:.3g} mm, to a slope of {slope:.2g} "
        f"deg; {len(surface.fitted):,} points, residuals {surface.rms * 1e6:.2g} um",
        fontsize=9,
    )
    axes.set_aspect("equal", adjustable="datalim")
    axes.set_xlabel("x / mm")
    axes.set_ylabel("y / mm")


def _write_values(
    axes: Axes, standing: Standing, quantities: Mapping[str, DerivedQuantity]
) -> None:
    """Write what the mesh and the fit tell about the body."""
    axes.axis("off")
    smaller, larger = standing.surface.radii * 1e3
    parameters = standing.parameters
    skew = math.degrees(parameters["xi"])
    unsteady = "counterclockwise" if skew < 0 else "clockwise"
    lines = [
        f"mass {standing.mass.mass * 1e3:.4g} g",
        f"centre of mass {standing.height * 1e3:.4g} mm high",
        f"radii {smaller:.4g} and {larger:.4g} mm",
        f"  they change by {100 * standing.change:.2g} % with the range",
        f"skew {abs(skew):.3g} deg",
        f"third axis leans by {math.degrees(standing.tilt):.2g} deg",
    ]
    for name, label in (
        ("omega_p", "pitch"),
        ("omega_r", "roll"),
    ):
        found = quantities.get(name)
        if found is not None and found.in_si is not None:
            lines.append(f"{label} {found.in_si[0] / (2 * math.pi):.3g} Hz")
    lines += [f"spun {unsteady},", "  it turns back sooner"]
    axes.text(0.0, 0.98, "\n".join(lines), va="top", linespacing=1.6, fontsize=8.5)
