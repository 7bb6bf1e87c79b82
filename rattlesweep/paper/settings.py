"""How many samples the figures are made of: the paper's numbers, or fewer with ``--quick``.

Numbers that no one changes stand at the head of the modules in ``data/``.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from rattlesweep.sweeps.config.load import load_config

if TYPE_CHECKING:
    from rattlesweep.sweeps.config.schema import Config


@dataclass(frozen=True)
class Sizes:
    """Counts of bodies and runs, and one length."""

    fig2_bodies: int = 1_000_000  # the paper's number
    fig3_bodies: int = 100_000  # of (a), the paper's number
    fig3_density: int = 100_000_000  # bodies of (b), the paper's number
    samples: int = 1000  # of each point of Figs. 5 to 7, the paper's number
    rk4: int = 10  # samples of each case of Fig. 6 that are integrated with RK4 as well
    rk4_least_K_r: float = 0.0  # targets below are left out of this: they take longest
    lyapunov: int = 20_000  # most runs of type SW that are tried for chaos
    windows: int = 6000  # most runs of Fig. 7 that are followed in windows of time
    fig8_lyapunov_t_end: float = 500_000.0


FULL = Sizes()
QUICK = Sizes(
    fig2_bodies=50_000,
    fig3_density=2_000_000,
    samples=30,
    rk4=1,
    rk4_least_K_r=0.03,
    lyapunov=200,
    fig8_lyapunov_t_end=62_500.0,
)


def sweep_config(direction: str, sizes: Sizes) -> Config:
    """Config of the sweep of a direction, ``steady`` or ``unsteady``: that of ``configs/``."""
    path = Path(__file__).with_name(f"{direction}.yaml")
    return load_config(path, [f"bodies.samples={sizes.samples}"])
