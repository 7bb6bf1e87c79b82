"""Draw docs/orbits.png: the family of body A over the energy, and its doubled one.

python docs/figures/orbits.py
"""

from pathlib import Path

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

import rattlesweep as rs

BODY_A = rs.Rattleback(7, 3, 7, 1 / 4, 1 / 9, -0.485)
PAGE = Path(__file__).parents[1]


def main() -> None:
    start = rs.orbit(
        BODY_A,
        omega=(1.02, 1.19, -0.28),
        u=(-0.2898, -0.1618, -0.9433),
        period=7.9,
        energy=6.52,
    )
    down = rs.branch(start, "energy", to=6.3, steps=100)
    up = rs.branch(start, "energy", to=7.0, steps=40)
    figure = Figure(figsize=(7.2, 3.2), layout="constrained", dpi=150)
    FigureCanvasAgg(figure)
    axes = figure.subplots(1, 2)
    for axis, y in zip(axes, ("period", "n_mean"), strict=True):
        up.plot(y=y, ax=axis)
        down.plot(y=y, ax=axis)
        axis.set_xlim(6.35, 7.05)
    figure.savefig(PAGE / "orbits.png")
    print(down)
    print(up)


if __name__ == "__main__":
    main()
