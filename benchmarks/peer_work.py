"""The work that every method of ``peers.py`` does, and how it is timed."""

from __future__ import annotations

import os
import platform
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from rattlesweep.integrate.batch import Batch, integrate
from rattlesweep.integrate.compile import source_hash
from rattlesweep.integrate.model import FULL
from rattlesweep.integrate.tableau import METHODS
from rattlesweep.sweeps.config.read import load_config, parse_config
from rattlesweep.sweeps.launches import full_batch, prepare
from rattlesweep.sweeps.plan import make_plan

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    Floats = NDArray[np.float64]
    Solve = Callable[[Batch], Floats]

STEADY = Path(__file__).resolve().parent.parent / "configs" / "steady.yaml"
GH = {
    "name": "gh",
    "bodies": {"source": "preset", "name": "GH"},
    "spin": {
        "n_i": [s * n for s in (-1, 1) for n in (0.1, 0.2, 0.3, 0.4, 0.5)],
        "omega_xy0": [0.001, 0.01, 0.1],
    },
    "horizon": {"t_rgh": 5},
    "output": "unused",
}
HORIZON = 2000.0
AGREE = 1e-8


@dataclass(frozen=True)
class Work:
    """Runs and their reversal times.

    Attributes
    ----------
    runs : Batch
        The runs, in the order of their cases.
    t_ref : ndarray
        First zero of the spin; NaN where there is none before the horizon.
    """

    runs: Batch
    t_ref: Floats

    @property
    def units(self) -> float:
        """Total time to integrate, in ``sqrt(a/g)``."""
        return float(np.where(np.isnan(self.t_ref), self.runs.t_end, self.t_ref).sum())

    def take(self, index: NDArray[np.intp] | NDArray[np.bool_]) -> Work:
        """Some of the runs."""
        return Work(take(self.runs, index), self.t_ref[index])

    def tiled(self, least: int) -> tuple[Batch, int]:
        """Return the runs, repeated until there are ``least`` or more, and the
        repeats.
        """
        copies = -(-least // len(self.runs))
        return take(self.runs, np.tile(np.arange(len(self.runs)), copies)), copies


@dataclass(frozen=True)
class Errors:
    """Errors of a method's reversal times."""

    median: float
    p99: float
    missed: int
    false: int
    other_zero: int
    runs: int


def take(runs: Batch, index: NDArray[Any]) -> Batch:
    """Some of the runs of a batch."""
    parts = {name: getattr(runs, name) for name in Batch.__dataclass_fields__}
    # Fields that have no entry per run stay as they are.
    return Batch(
        **{name: part[index] if len(part) else part for name, part in parts.items()}
    )


def draw(samples: int) -> Batch:
    """Runs of ``configs/steady.yaml``, ``samples`` of each of its 120 cases, and the GH
    body.
    """
    parts = []
    for config in (
        load_config(STEADY, [f"bodies.samples={samples}"]),
        parse_config(GH),
    ):
        plan = make_plan(config)
        case, sample = np.divmod(np.arange(plan.runs), plan.samples)
        parts.append(full_batch(prepare(plan, case, sample)))
    joined = {
        name: np.concatenate([getattr(part, name) for part in parts])
        for name in Batch.__dataclass_fields__
    }
    joined["t_end"] = np.minimum(joined["t_end"], HORIZON)
    return Batch(**joined)


def rattlesweep(method: str, *, tol: float = 1e-9, dt: float = 0.002) -> Solve:
    """Rattlesweep's own kernel on one thread."""

    def solve(runs: Batch) -> Floats:
        return integrate(runs, METHODS[method], FULL, tol=tol, dt=dt, threads=1).t_r

    return solve


def errors(t_r: Floats, work: Work) -> Errors:
    """Compare times of reversal with the reference."""
    both = ~np.isnan(t_r) & ~np.isnan(work.t_ref)
    off = np.abs(t_r - work.t_ref)
    relative = (off / work.t_ref)[both]
    quarter = 0.25 * 2 * np.pi / work.runs.swing
    return Errors(
        median=float(np.median(relative)) if both.any() else np.nan,
        p99=float(np.percentile(relative, 99)) if both.any() else np.nan,
        missed=int((np.isnan(t_r) & ~np.isnan(work.t_ref)).sum()),
        false=int((~np.isnan(t_r) & np.isnan(work.t_ref)).sum()),
        other_zero=int((off > quarter)[both].sum()),
        runs=len(t_r),
    )


def timed(solve: Solve, runs: Batch) -> tuple[float, Floats]:
    """Seconds of processor time, of all threads of this process, and the result.

    Other work on the machine does not count, and a method that secretly used two
    threads would pay for both.
    """
    begin = time.process_time()
    t_r = solve(runs)
    return time.process_time() - begin, t_r


def cost_at(error: float, errors: Floats, costs: Floats) -> tuple[float, str]:
    """Return the cost at an error, log-log along a curve, and a mark where the curve
    ends before.

    Returns
    -------
    cost : float
        Beyond the ends of the curve, the cost at the end.
    mark : str
        ``<`` if the cost is at most this (the error asked for is larger than any measured), ``>``
        if it is at least this.
    """
    order = np.argsort(errors)
    x, y = np.log(errors[order]), np.log(costs[order])
    mark = "<" if np.log(error) > x[-1] else ">" if np.log(error) < x[0] else ""
    return float(np.exp(np.interp(np.log(error), x, y))), mark


def first_call() -> float:
    """Seconds of the first, short call of rattlesweep in this process."""
    runs = take(draw(1), np.arange(1))
    begin = time.perf_counter()
    rattlesweep("dop853", tol=1e-3)(runs)
    return time.perf_counter() - begin


def first_calls() -> tuple[float, float]:
    """Seconds of a first call when nothing is compiled yet, and when it is in the
    cache.
    """
    code = "import peer_work; print(peer_work.first_call())"
    with tempfile.TemporaryDirectory() as directory:
        environment = os.environ | {"NUMBA_CACHE_DIR": directory}
        seconds = [
            float(
                subprocess.run(
                    [sys.executable, "-c", code],
                    env=environment,
                    cwd=Path(__file__).resolve().parent,
                    capture_output=True,
                    text=True,
                    check=True,
                ).stdout
            )
            for _ in range(2)
        ]
    return seconds[0], seconds[1]


def source() -> str:
    """Return a hash of the compiled sources, which identifies the rattlesweep that was
    measured.
    """
    return source_hash()[:8]


def processor() -> str:
    """Name of the processor, where the system tells."""
    info = Path("/proc/cpuinfo")
    name = platform.processor() or platform.machine()
    if info.exists():
        for line in info.read_text().splitlines():
            if line.startswith("model name"):
                name = line.split(":", 1)[1].strip()
                break
    return f"{name}, {os.cpu_count()} processors"
