"""Draw the reversal times of ellipsoids over those of paraboloids, against c.

    python docs/figures/surface.py [docs/surface.png]

The bodies are the first 300 of seed 2017 (shell-dumbbell), launched along their
relevant modes.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import numpy as np
from matplotlib import pyplot as plt

import rattlesweep as rs

C = np.geomspace(1.0, 100.0, 7)
LAUNCHES = ((0.1, 0.01), (0.1, 0.1), (-0.1, 0.1))


def times(c: float | None, n_i: float, omega_xy0: float) -> np.ndarray:
    """First reversals of all bodies, NaN where there is none."""
    bodies = {"source": "sd", "samples": 300} | ({} if c is None else {"c": c})
    spin = {"n_i": n_i, "omega_xy0": omega_xy0}
    config = {"seed": 2017, "bodies": bodies, "spin": spin, "horizon": {"t_rgh": 3}}
    with tempfile.TemporaryDirectory() as folder:
        found = rs.sweep(config, output=Path(folder) / "out").read(columns=["t_r"])
    return found.t_r.to_numpy(float)


figure, axes = plt.subplots(figsize=(6.4, 3.8), layout="constrained")
for n_i, omega_xy0 in LAUNCHES:
    flat = times(None, n_i, omega_xy0)
    ratio = np.array([times(c, n_i, omega_xy0) / flat for c in C])
    low, middle, high = np.nanpercentile(ratio, [5, 50, 95], axis=1)
    (line,) = axes.plot(
        C, middle, "o-", ms=4, label=f"n_i = {n_i:g}, omega_xy0 = {omega_xy0:g}"
    )
    axes.fill_between(C, low, high, color=line.get_color(), alpha=0.2, linewidth=0)
    print(
        n_i,
        omega_xy0,
        *(
            f"{c:.3g}:{a:.4f}/{b:.4f}/{d:.4f}"
            for c, a, b, d in zip(C, low, middle, high, strict=True)
        ),
    )
axes.set_ylim(0.95, 2.2)
axes.axhline(1, color="#888888", linewidth=0.8)
axes.set(
    xscale="log",
    xlabel="c, vertical semi-axis over a",
    ylabel="t_r over the paraboloid's (median, 5 to 95 %)",
)
axes.legend(frameon=False)
figure.savefig(sys.argv[1] if len(sys.argv) > 1 else "docs/surface.png", dpi=130)
