"""Numbers of creep, viscous slip and a plane that shakes, beside known ones.

    python benchmarks/laws.py
    python benchmarks/laws.py --energy

The known numbers are closed forms, or those of independent programs, which integrate
the velocity of the foot or the body's axes as vectors.  ``--energy`` counts, of 1,000
runs of Table I with each law, statuses and the largest error of energy minus work.
"""

from __future__ import annotations

import tempfile
from typing import TYPE_CHECKING, Any

import click
from machine import heading
from scipy.constants import degree

import rattlesweep as rs
from rattlesweep.analysis.derived import derived
from rattlesweep.physics.driven import driven_spin, growth_of_drive
from rattlesweep.physics.theory import slip_thresholds

if TYPE_CHECKING:
    from collections.abc import Iterator

Row = tuple[str, str, float, float]  # law, quantity, known, here

GH = rs.Rattleback.gh()
MODES = rs.modes(GH)
SKEWED = GH.replace(xi=-5 * degree)
# Spin, lever, friction in the patch, and the eigenvalue of the whole patch.
GROWTH = (
    (-0.1, 0.002, 0.5, 0.004632),
    (-0.1, 0.006, 0.3, 0.003638),
    (-0.2, 0.006, 0.3, 0.006884),
    (0.1, 0.006, 0.3, 0.026837),
)
# Launch, lever, friction in the patch, and the first reversal of the whole patch.
REVERSALS = (
    (-0.2, 0.1, 0.006, 0.5, 224.682),
    (-0.2, 0.1, 0.006, 0.3, 255.724),
    (-0.3, 0.01, 0.006, 0.5, 463.177),
    (-0.3, 0.01, 0.006, 0.2, 604.713),
)
# Largest spins of successive turns of the nine variables.
PEAKS = {
    50.0: (0.09366, 0.05959, 0.05272, 0.01860),
    100.0: (0.09699, 0.07997, 0.07659, 0.05955, 0.05612, 0.03906, 0.03559),
}
LAWS: dict[str, dict[str, Any]] = {
    "nothing": {},
    "sigma": {"dissipation": {"sigma": 0.001}},
    "pivot": {"dissipation": {"pivot": 0.002}},
    "pivot, creep": {"dissipation": {"pivot": 0.002, "creep": 0.3}},
    "viscous": {"dissipation": {"viscous": 50}},
    "base": {"base": {"frequency": 2.8, "acceleration": 0.1}},
    "reduced": {
        "model": "reduced",
        "dissipation": {"sigma": 0.001, "pivot": 0.002, "creep": 0.3},
    },
    "base along": {
        "base": {
            "frequency": 1.4,
            "acceleration": 0.1,
            "direction": "horizontal",
            "azimuth_deg": 45,
        }
    },
}


def creep() -> Iterator[Row]:
    """Yield shares, growth rates and reversals with a patch that gives way."""
    told = derived(GH, -0.2, 0.1, pivot=0.006, creep=0.3)
    values = {each.name: each.value for each in told}
    for name, known in (("p", 0.24747), ("r", 0.33948)):
        taken = values[f"K_{name}"] - values[f"K_{name}_creep"]
        yield "creep", f"c_{name}", known, taken * 0.3**2 / 0.006
    for n, pivot, mu, known in GROWTH:
        mode = 0 if n > 0 else 1
        plain = rs.growth_rates(GH, n, exact=True)[mode]
        limit = rs.growth_rates(GH, n)[mode]
        taken = limit - rs.growth_rates(GH, n, pivot=pivot, creep=mu)[mode]
        yield "creep", f"growth at {n}, {pivot}, {mu}", known, plain - taken
    for n, push, pivot, mu, known in REVERSALS:
        run = rs.simulate(
            GH, n_i=n, omega_xy0=push, pivot=pivot, creep=mu, t_end=1000.0
        )
        found = run.t_r or run.t_held
        what = "reversal" if run.t_r else "held"
        yield "creep", f"{what} from {n}, {push}, {pivot}, {mu}", known, found
    run = rs.simulate(
        GH, n_i=-0.3, omega_xy0=0.05, pivot=0.006, creep=0.3, mu=0.3, t_end=1000.0
    )
    yield "creep, mu", "reversal from -0.3, 0.05, 0.006, 0.3", 329.968, run.t_r


def viscous() -> Iterator[Row]:
    """Yield losses of modes, the first zero, and the spins of successive turns."""
    thresholds = slip_thresholds(GH.alpha, GH.beta, MODES, 200.0)
    known = 8.58675e-4, 1.177922e-3
    for name, n, share in zip(("p", "r"), thresholds, known, strict=True):
        yield "viscous", f"gamma_{name} at 200", share, n * getattr(MODES, f"K_{name}")
    for k, spins in PEAKS.items():
        run = rs.simulate(
            SKEWED,
            n_i=0.1,
            omega_xy0=0.01,
            viscous=k,
            t_end=20_000.0,
            tol=1e-11,
            record="reversals",
        )
        if k == 50:
            yield "viscous", "first zero at 50", 44.041004, run.turn_times[0]
        for turn, (known, found) in enumerate(
            zip(spins, run.spin_after_turn, strict=False), 1
        ):
            yield "viscous", f"spin after turn {turn} at {k:g}", known, found


def base() -> Iterator[Row]:
    """Yield the spins to which drives tuned to the pitch lead."""
    omega = float(MODES.omega_p)
    for acceleration, sigma in ((0.02, 0.01), (0.05, 0.02)):
        run = rs.simulate(
            GH,
            n_i=0,
            omega_xy0=1e-4,
            sigma=sigma,
            base=(2 * omega, acceleration),
            t_end=20_000.0,
            record="late",
        )
        growth = growth_of_drive(omega, 2 * omega, acceleration)
        known = driven_spin(growth, sigma / 2 / 12.054362, MODES.K_p)
        yield "base", f"spin at {acceleration}, {sigma}", float(known), run.n_late_mean


ROWS = {"creep": creep, "viscous": viscous, "base": base}


def energy(tol: float) -> None:
    """Print statuses and the largest error of energy minus work with each law."""
    for law, keys in LAWS.items():
        config = {
            "name": "energy",
            "seed": 57,
            "bodies": {"source": "sd", "samples": 125},
            "spin": {"n_i": [0.1, 0.3, -0.1, -0.3], "omega_xy0": [0.01, 0.1]},
            "horizon": {"t": 500},
            "integrator": {"tol": tol},
        }
        if "model" in keys:
            config["spin"] |= {"psi": 20}  # energy for both modes
        with tempfile.TemporaryDirectory() as folder:
            runs = rs.sweep(config | keys | {"output": folder}, progress=False).runs
        counts = runs["status"].value_counts().to_dict()
        worst = runs["energy_drift"].abs().max()
        click.echo(f"{law:14}{counts!s:42}{worst:10.1e}")


@click.command()
@click.option("--energy", "of_energy", is_flag=True, help="Count 1,000 runs each.")
@click.option("--tol", default=1e-9, show_default=True, help="Tolerance of --energy.")
@click.option("--law", "laws", multiple=True, type=click.Choice(list(ROWS)))
def main(of_energy: bool, tol: float, laws: tuple[str, ...]) -> None:
    """Print known numbers and ours, or the errors of the energy."""
    click.echo(heading())
    if of_energy:
        energy(tol)
        return
    for law in laws or ROWS:
        for name, quantity, known, found in ROWS[law]():
            off = found / known - 1
            click.echo(f"{name:11}{quantity:38}{known:14.8g}{found:16.9g}{off:10.1e}")


if __name__ == "__main__":
    main()
