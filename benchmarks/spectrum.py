"""Five checks of the spectrum of Lyapunov exponents, over random bodies.

    python benchmarks/spectrum.py [--bodies N] [--t-end T]

The bodies are those of the paper's Table I, each launched in both directions at two
spins after two pushes.  Printed are the median and the largest deviation.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import click
import numpy as np
from machine import all_runs, heading

from rattlesweep.config.read import parse_config
from rattlesweep.design.plan import make_plan
from rattlesweep.kernel.batch import integrate, longest_frame_steps
from rattlesweep.kernel.growths import exponents
from rattlesweep.kernel.method.tableau import DOP853
from rattlesweep.motion.model import FULL
from rattlesweep.physics import steady

if TYPE_CHECKING:
    from rattlesweep.arrays import Floats
    from rattlesweep.kernel.outcome import Batch

TOLERANCES = (1e-9, 1e-11)
SPINS = (-0.4, -0.1, 0.1, 0.4)
PUSHES = (0.001, 0.03)
# A push so small that the oscillation stays linear for a time.
TINY = 1e-100
LINEAR = 300.0
SPECTRUM = frozenset(["spectrum", "volume"])
LYAPUNOV = frozenset(["lyapunov", "reversals"])


def launched(bodies: int, t_end: float, pushes: tuple[float, ...]) -> Batch:
    """Return the runs of random bodies."""
    config = {
        "bodies": {"source": "sd", "samples": bodies},
        "spin": {"n_i": list(SPINS), "omega_xy0": list(pushes)},
        "horizon": {"t": t_end},
    }
    _, batch = all_runs(make_plan(parse_config(config)))
    return batch


def tilt(y: Floats) -> Floats:
    """Return the logarithm of an area of slopes over the same area of ``u``."""
    return 1.5 * np.log1p(y[:, 0] ** 2 + y[:, 1] ** 2)


def told(what: str, deviations: Floats) -> None:
    """Print the median and the largest deviation."""
    size = np.abs(deviations)
    click.echo(f"| {what} | {np.median(size):.1e} | {size.max():.1e} |")


def descending(values: Floats) -> Floats:
    """Return the exponents of each run in descending order."""
    return -np.sort(-values, axis=1)


def check_motion(batch: Batch, t_end: float, tol: float) -> None:
    """Check sums, vanishing exponents, the largest one and reversed time."""
    runs = integrate(batch, DOP853, FULL, tol=tol, record=SPECTRUM)
    assert (runs.status == 0).all()
    whole, _ = exponents(runs.growth)
    told(f"flow and energy, times t_end ({tol:g})", whole[:, 3:] * t_end)
    change = (tilt(runs.y_end) - tilt(batch.y0)) / t_end
    total = whole.sum(axis=1)
    told(f"sum less the rate of volume ({tol:g})", total - runs.volume_rate - change)
    one = integrate(
        batch,
        DOP853,
        FULL,
        tol=tol,
        record=LYAPUNOV,
        longest_step=longest_frame_steps(batch, DOP853, tol),
    )
    largest, _ = exponents(one.lyapunov)
    told(f"first tangent less lyapunov ({tol:g})", whole[:, 0] - largest[:, 0])
    back = runs.y_end.copy()
    back[:, 2:] *= -1
    returned = integrate(
        replace(batch, y0=back), DOP853, FULL, tol=tol, record=SPECTRUM
    )
    home = returned.y_end.copy()
    home[:, 2:] *= -1
    is_same = np.abs(home - batch.y0).max(axis=1) < 1e-6
    backward, _ = exponents(returned.growth)
    sums = (total + backward.sum(axis=1))[is_same]
    told(f"reversed in time: sum of both sums ({tol:g})", sums)
    pairs = descending(whole) - descending(-backward)
    told(f"reversed: exponents, times t_end ({tol:g})", pairs[is_same] * t_end)
    click.echo(f"{is_same.sum()} of {len(is_same)} runs come back to 1e-6.")


def check_steady(batch: Batch) -> None:
    """Compare exponents near a steady spin with the real parts of its eigenvalues."""
    runs = integrate(batch, DOP853, FULL, tol=1e-11, record=SPECTRUM)
    whole, _ = exponents(runs.growth)
    pitch, roll = steady.growth(batch.constants.T, batch.y0[:, 4] * -1)
    rates = np.stack([pitch, pitch, roll, roll, np.zeros(len(pitch))], axis=1)
    deviations = descending(whole) - descending(rates)
    # Rows end where the flow has decayed too far.
    until = np.nanmax(runs.growth[:, :, 0], axis=1)
    told("steady spins: exponents, times their time", deviations * until[:, None])


@click.command()
@click.option("--bodies", default=200)
@click.option("--t-end", default=3000.0)
def main(bodies: int, t_end: float) -> None:
    """Print the table of deviations."""
    click.echo(heading())
    click.echo("\n| check | median | largest |\n|---|---|---|")
    batch = launched(bodies, t_end, PUSHES)
    for tol in TOLERANCES:
        check_motion(batch, t_end, tol)
    check_steady(launched(bodies, LINEAR, (TINY,)))


if __name__ == "__main__":
    main()
