"""Draw for docs/accuracy.md where the error of one reversal time comes from.

python docs/figures/sensitive.py docs/sensitive.png python docs/figures/sensitive.py
worst    # the last columns of the table in benchmarks/README.md

The runs are those of sensitive.csv: ten of the worst of configs/quickstart.yaml, as
version 0.2.0 drew its bodies.
"""

import csv
import sys
from dataclasses import replace
from pathlib import Path

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np

from rattlesweep.arrays import take
from rattlesweep.config.read import parse_config
from rattlesweep.design.plan import make_plan
from rattlesweep.kernel.batch import integrate
from rattlesweep.kernel.follow import Follower
from rattlesweep.kernel.method.tableau import METHODS
from rattlesweep.motion.model import FULL
from rattlesweep.physics.steady import growth, steady_modes
from rattlesweep.work.block import prepare_runs

RUNS = Path(__file__).with_name("sensitive.csv")
ROW = 4
# Its reversal time in double-double arithmetic (benchmarks/double_double.py).
TRUE = 2467.883536
TOLS = {1e-6: "#D55E00", 1e-9: "#0072B2", 1e-12: "#009E73"}
KICKS = {1e-13: "#009E73", 1e-11: "#56B4E9", 1e-9: "#0072B2"}


def launch(row):
    """Return the name of a run and the run, as a batch of one."""
    plan = make_plan(parse_config({"bodies": {"source": "table", "path": str(RUNS)}}))
    _, one = prepare_runs(plan, np.array([0]), np.array([row]))
    with RUNS.open() as file:
        return list(csv.DictReader(file))[row]["run"], one


def path(one, tol, times):
    """Return the states of the run at times, by dop853."""
    return Follower(one, METHODS["dop853"], FULL, tol=tol).at(times).y


def pitch(one, difference, y):
    """Return the amplitude of the pitch in a difference of two runs, at the spin of
    ``y``.
    """
    p, q, a, b, c = y.T
    n = -(p * a + q * b + c) / np.sqrt(1 + p * p + q * q)
    probe = steady_modes(one.constants[0][:, None], n).pitch_probe
    return np.abs((probe * difference[:, :4]).sum(axis=1))


def envelope(values, width=25):
    """Return the largest of the values around each."""
    return np.array(
        [values[max(0, k - width) : k + width].max() for k in range(len(values))]
    )


def shifts(one, times, y, size, repeats=12):
    """Return the median change of t_r after kicks in random directions, at some
    times.
    """
    rng = np.random.default_rng(0)
    many = take(one, np.zeros(len(times) * repeats, dtype=int))
    kick = rng.standard_normal((len(many), 4))
    kick /= np.linalg.norm(kick, axis=1)[:, None]
    y0 = np.repeat(y, repeats, axis=0)
    y0[:, :4] += size * np.linalg.norm(y0[:, :4], axis=1)[:, None] * kick
    begin = np.repeat(times, repeats)
    rest = replace(many, y0=y0, t_end=many.t_end - begin)
    t_r = integrate(rest, METHODS["verner98"], FULL, tol=1e-14, threads=1).t_r + begin
    return np.nanmedian(np.abs(t_r - TRUE).reshape(len(times), repeats), axis=1)


def main(target: str) -> None:
    """Draw where the errors of one run come from."""
    mpl.use("Agg")
    plt.rcParams.update(
        {"font.size": 9, "axes.linewidth": 0.6, "legend.frameon": False}
    )
    _, one = launch(ROW)
    figure, (left, middle, right) = plt.subplots(
        1, 3, figsize=(10.0, 3.3), layout="constrained"
    )

    times = np.arange(0.0, 2440.0, 1.0)
    exact = path(one, 1e-15, times)
    left.semilogy(
        times,
        envelope(np.linalg.norm(exact[:, :4], axis=1)),
        "k",
        lw=0.8,
        label="oscillation",
    )
    for tol, colour in TOLS.items():
        y = path(one, tol, times)
        upto = min(len(y), len(exact))
        apart = envelope(pitch(one, y[:upto] - exact[:upto], exact[:upto]))
        left.semilogy(
            times[:upto],
            apart,
            color=colour,
            lw=0.9,
            label=f"pitch error, tol {tol:.0e}".replace("e-0", "e-"),
        )
    left.set(
        xlabel="$t$",
        ylabel="amplitude",
        ylim=(1e-16, 1e5),
        title="(a) error of the pitch",
    )
    left.legend(fontsize=7, loc="upper left")

    begin = np.arange(0.0, 2440.0, 20.0)
    start = path(one, 1e-15, begin)
    for size, colour in KICKS.items():
        middle.semilogy(
            begin,
            shifts(one, begin, start, size),
            ".-",
            ms=3,
            lw=0.7,
            color=colour,
            label=f"kick of {size:.0e}".replace("e-0", "e-"),
        )
    middle.set(
        xlabel="time of the kick",
        ylabel="change of $t_r$",
        title="(b) response to a kick",
    )
    middle.legend(fontsize=7, loc="upper left")

    tols = 10.0 ** -np.arange(5, 15.5, 0.5)
    for method, mark in (("dop853", "o"), ("verner98", "s")):
        t_r = [
            integrate(one, METHODS[method], FULL, tol=tol, threads=1).t_r[0]
            for tol in tols
        ]
        right.loglog(
            tols, np.abs(np.array(t_r) - TRUE), mark + "-", ms=3.5, lw=0.7, label=method
        )
    right.set(
        xlabel="tol", ylabel="error of $t_r$", title="(c) error against tolerance"
    )
    right.legend(fontsize=7)
    figure.savefig(Path(target), dpi=150)


def worst() -> None:
    """Print by how much the pitch decays, how fast its error then grows, and when."""
    width = 40
    for row in range(10):
        name, one = launch(row)
        t_r = integrate(one, METHODS["verner98"], FULL, tol=1e-14, threads=1).t_r[0]
        times = np.arange(0.0, int(t_r) - 5)
        exact = path(one, 1e-15, times)
        y = path(one, 1e-9, times)
        p, q, a, b, c = exact.T
        n = -(p * a + q * b + c) / np.sqrt(1 + p * p + q * q)
        decay = growth(one.constants[0][:, None], n)[0].sum()
        upto = min(len(y), len(exact))
        apart = envelope(pitch(one, y[:upto] - exact[:upto], exact[:upto]))
        size = envelope(np.linalg.norm(exact[:upto, :4], axis=1))
        rate = np.log(apart[width:] / apart[:-width]) / width
        # Late in the run, and before the error is as large as the oscillation.
        late = (times[: len(rate)] > 0.8 * t_r) & (apart[width:] < 0.3 * size[width:])
        at = np.flatnonzero(late)[np.argmax(rate[late])]
        when = (at + width / 2) / t_r
        print(f"{name}: e^{decay:.0f}, then {rate[at]:.2f} at {when:.2f}")


if __name__ == "__main__":
    worst() if sys.argv[1:] == ["worst"] else main(*sys.argv[1:])
