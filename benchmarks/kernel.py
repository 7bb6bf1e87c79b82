"""Speed of the lane kernels against plain scalar code, in one run on one machine.

    python benchmarks/kernel.py [--lanes | --throughput] [--quick]

Both batches are GH launched at random spins.  *equal*: every run has the same horizon.
*mixed*: horizons spread as in a sweep of shell-dumbbell bodies, the longest thirty
times the shortest.  No run reverses within its horizon, so that all methods integrate
the same time.  Measurements of all kernels are interleaved and repeated; the tables
show medians.

``--throughput`` prints the table of benchmarks/README.md: steps tried and accepted in
the mix of ``configs/steady.yaml``, and their share of the processor's peak of fused
multiply-adds.  Products and fused multiply-adds, which use the same units, are counted
in the machine code of the step for one lane.  The peak is measured with a loop of fused
multiply-adds.
"""

import os
import platform
import re
import statistics
import sys
import time
from functools import partial
from pathlib import Path

import click
import llvmlite
import numba
import numpy as np
import peer_work
from numba import float64, njit, prange, set_num_threads, typeof

from rattlesweep.integrate.batch import Batch, integrate, problem_of
from rattlesweep.integrate.lanes.lane import LANES, Layout, widest_vectors
from rattlesweep.integrate.lanes.step import OPTIONS, write_attempt
from rattlesweep.integrate.model import FULL
from rattlesweep.integrate.tableau import METHODS
from rattlesweep.physics import full, steady, theory
from rattlesweep.physics.body import PARAMETERS, Rattleback

DT, TOL = 0.002, 1e-9
OMEGA = 0.01
N_WINDOWS = 64
BODY = {name: getattr(Rattleback.gh(), name) for name in PARAMETERS}


@full.scalar
def _moved(y, h, k):  # type: ignore[no-untyped-def]
    """Return ``y + h k``, component by component."""
    return (
        y[0] + h * k[0],
        y[1] + h * k[1],
        y[2] + h * k[2],
        y[3] + h * k[3],
        y[4] + h * k[4],
    )


@full.scalar
def rk4_step(y, body, dt):  # type: ignore[no-untyped-def]
    """Return the state after one step of the classical method; `y` and `body` are
    tuples.
    """
    k1 = full.rhs(*(y + body))
    k2 = full.rhs(*(_moved(y, dt / 2, k1) + body))
    k3 = full.rhs(*(_moved(y, dt / 2, k2) + body))
    k4 = full.rhs(*(_moved(y, dt, k3) + body))
    slope = _moved(_moved(k1, 2.0, _moved(k2, 1.0, k3)), 1.0, k4)
    return _moved(y, dt / 6, slope)


@njit(fastmath=full.FASTMATH, error_model="numpy", nogil=True, parallel=True)
def plain_rk4(y0, constants, t_end, dt, out):
    """The kernel that one would write first: scalar, one run after another, ``prange``
    over runs.

    The classical method with the kernel's own right-hand side; a run ends where the
    spin changes its sign between two steps.  It has no step control, no search within a
    step and no observables.
    """
    for k in prange(len(y0)):
        ix, iy, iz, cxx, cxy, cyy = constants[k]
        p, q, a, b, c = y0[k]
        y, body = (p, q, a, b, c), (ix, iy, iz, cxx, cxy, cyy)
        n = full.spin(*y)
        steps = round(t_end[k] / dt)
        for _ in range(steps):
            y = rk4_step(y, body, dt)
            n1 = full.spin(*y)
            if n * n1 <= 0:
                break
            n = n1
        for i in range(5):
            out[k, i] = y[i]


def batch(t_end):
    """Return GH at spins from -0.15 to -0.1, which reverse at t = 450 or later."""
    runs = len(t_end)
    n_i = np.random.default_rng(1).uniform(-0.15, -0.1, runs)
    constants = full.constants(
        **{name: np.full(runs, value) for name, value in BODY.items()}
    )
    modes = theory.modes(
        *(BODY[name] for name in ("alpha", "beta", "theta", "phi", "xi"))
    )
    found = steady.steady_modes(constants, n_i)
    return Batch(
        y0=theory.full_state(n_i, OMEGA, theory.direction(modes, n_i, "relevant")),
        constants=constants.T.copy(),
        probe=np.concatenate([found.roll_probe.real, found.roll_probe.imag], axis=1),
        t_end=t_end,
        swing=2 * np.maximum(np.abs(found.pitch.imag), modes.omega_p),
        relevant=np.abs(found.roll.imag),
        rate=np.full(runs, 0.01),
        window=t_end / N_WINDOWS,
        first_mark=t_end,
        scale=np.abs(n_i),
        tapped=np.zeros(runs, bool),
    )


def plain(runs, threads):
    """Run the plain kernel and return the number of steps."""
    set_num_threads(threads)
    plain_rk4(runs.y0, runs.constants, runs.t_end, DT, np.empty_like(runs.y0))
    return int(np.round(runs.t_end / DT).sum())


def lanes(method):
    """A function that runs the lane kernel and returns the number of steps, tried ones
    too.
    """

    def run(runs, threads):
        out = integrate(runs, METHODS[method], FULL, tol=TOL, dt=DT, threads=threads)
        if not np.array_equal(out.t_end, runs.t_end):
            raise click.ClickException(f"{method}: a run did not reach its horizon")
        return int(out.n_steps.sum() + out.n_rejected.sum())

    return run


KERNELS = {
    "plain scalar rk4": plain,
    **{f"lanes {name}": lanes(name) for name in ("rk4", "dop853", "dopri5")},
}


# Runs and their mean horizon, for about 0.3 s per measurement with one thread.
SIZES = {
    "plain scalar rk4": (2048, 4.8),
    "lanes rk4": (8192, 8.0),
    "lanes dop853": (32768, 100.0),
    "lanes dopri5": (8192, 100.0),
}


def cases(quick):
    """Batches by case and kernel."""
    stride = (
        8 * DT
    )  # the kernel checks lanes every eight steps, so horizons are multiples of that
    for case in ("equal", "mixed"):
        batches = {}
        for name, (runs, mean) in SIZES.items():
            runs = max(2048, runs // 4) if quick else runs
            spread = np.exp(np.random.default_rng(0).uniform(0, np.log(30), runs))
            shape = np.ones(runs) if case == "equal" else spread / spread.mean()
            batches[name] = batch(
                np.maximum(1, np.round(shape * mean / stride)) * stride
            )
        yield case, batches


def measure(batches, repeats):
    """Median seconds and the steps of every kernel on one and two threads,
    interleaved.
    """
    counts = (1, 2) if numba.config.NUMBA_NUM_THREADS > 1 else (1,)
    seconds = {(name, threads): [] for name in batches for threads in counts}
    steps = {}
    for repeat in range(repeats + 1):
        for name, threads in seconds:
            begin = time.perf_counter()
            steps[name] = KERNELS[name](batches[name], threads)
            spent = time.perf_counter() - begin
            if repeat:  # the first round compiles or loads
                seconds[name, threads].append(spent)
    return {key: statistics.median(values) for key, values in seconds.items()}, steps


def processor():
    """Name of the processor, where the system tells."""
    info = Path("/proc/cpuinfo")
    if info.exists():
        for line in info.read_text().splitlines():
            if line.startswith("model name"):
                return line.split(":", 1)[1].strip()
    return platform.processor() or platform.machine()


def heading():
    """Machine and versions."""
    click.echo(f"{processor()}, {os.cpu_count()} processors")
    click.echo(
        f"Python {platform.python_version()}, NumPy {np.__version__}, Numba {numba.__version__}, "
        f"llvmlite {llvmlite.__version__}, {platform.system()} {platform.release()}"
    )


def show_kernels(quick):
    """The table of kernels; exit code 1 if the requirements are missed."""
    heading()
    click.echo(f"rk4: dt = {DT}; others: tol = {TOL}; {LANES} lanes; medians")
    head = f"{'':18}{'M steps/s':>10}{'us per unit':>13}"
    head += f"{'ratio to':>11}{'time to':>10}{'2 threads':>11}"
    below = f"{'':18}{'1 thread':>10}{'time and run':>13}{'plain step':>11}{'plain':>10}{'over 1':>11}"
    results = {}
    for case, batches in cases(quick):
        seconds, steps = measure(batches, 3 if quick else 7)
        click.echo(
            f"\n{case} lengths, {min(map(len, batches.values()))} runs or more\n{head}\n{below}"
        )
        base = None
        for name, runs in batches.items():
            one = seconds[name, 1]
            rate = steps[name] / one / 1e6
            unit = one / runs.t_end.sum() * 1e6
            base = base or (rate, unit)
            gain = one / seconds[name, 2] if (name, 2) in seconds else float("nan")
            results[case, name] = rate / base[0], gain
            click.echo(
                f"{name:18}{rate:10.1f}{unit:13.3f}{rate / base[0]:10.1f}x"
                f"{base[1] / unit:9.1f}x{gain:10.2f}x"
            )
    met = True
    ratio, gain = results["equal", "lanes rk4"]
    click.echo()
    for text, value, wanted in (
        ("lanes rk4 over plain scalar, steps per second", ratio, 8.0),
        ("lanes rk4, two threads over one", gain, 1.9),
    ):
        met &= value >= wanted
        verdict = "met" if value >= wanted else "MISSED"
        click.echo(f"{text}: {value:.2f}, wanted {wanted}: {verdict}")
    sys.exit(0 if met else 1)


def show_lanes(quick):
    """The generated step alone, for several numbers of lanes, one thread."""
    heading()
    widths = (8, 16, 32, 64)
    click.echo("generated step alone, M steps/s by number of lanes; medians")
    click.echo(f"{'':10}" + "".join(f"{width:>8}" for width in widths))
    at = Layout(FULL)
    n = FULL.n_state
    for name, tableau in METHODS.items():
        loops = {}
        for width in widths:
            attempt = njit(**OPTIONS)(write_attempt(tableau, FULL, width))
            size = (at.stages + tableau.stages * n) * width
            flat = np.zeros(size + 8)
            shift = (-flat.ctypes.data // 8) % 8
            flat = flat[shift : shift + size]
            rows = flat.reshape(-1, width)
            rows[at.constants : at.constants + 6] = full.constants(**BODY)[:, None]
            rows[at.y + 2], rows[at.y + 4] = OMEGA, -0.1
            rows[at.h] = 0.3 if tableau.adaptive else 8 * DT
            rows[at.probe : at.probe + FULL.n_probe] = 0.1
            problem = problem_of(FULL, tableau.adaptive, width)
            loops[width] = partial(_many(attempt), problem, flat)
        calls = (20_000 if quick else 100_000) // (
            tableau.stages * (1 if tableau.adaptive else 8)
        )
        times = {width: [] for width in widths}
        for repeat in range(4 if quick else 10):
            for width, many in loops.items():
                begin = time.perf_counter()
                many(calls * 64 // width)
                if repeat:
                    times[width].append(time.perf_counter() - begin)
        steps = calls * 64 * (1 if tableau.adaptive else 8)
        rates = [steps / statistics.median(times[width]) / 1e6 for width in widths]
        click.echo(f"{name:10}" + "".join(f"{rate:8.1f}" for rate in rates))


def _many(attempt):
    @njit(nogil=True)
    def many(problem, flat, calls):
        for _ in range(calls):
            attempt(problem, flat, 1e18)

    return many


# Products in machine code, fused or not, and their vector width.
PRODUCT = re.compile(r"^\s+v?(?:mul|fn?m(?:add|sub)\d*)([sp])d\s.*%([xyz])mm", re.M)
DOUBLES = {"x": 2, "y": 4, "z": 8}
# Short chains, because in a long one the units wait for the sum.
CHAIN, CELLS = 8, 64


def products(tableau):
    """Products in one step of a method for one lane; 0 where the machine code is not
    x86's.
    """
    step = njit(**OPTIONS)(write_attempt(tableau, FULL, 1))
    step.compile((typeof(problem_of(FULL, tableau.adaptive, 1)), float64[::1], float64))
    (code,) = step.inspect_asm().values()
    found = PRODUCT.findall(code)
    return sum(1 if width == "s" else DOUBLES[register] for width, register in found)


def peak(repeats):
    """Fused multiply-adds a second that one thread can do, of doubles in whole
    vectors.
    """
    names = {"widest_vectors": widest_vectors}
    chain = "\n".join(["            s = s * x + y"] * CHAIN)
    exec(
        f"def many(w, calls, x, y):\n    widest_vectors()\n    for _ in range(calls):\n"
        f"        for l in range({CELLS}):\n            s = w[l]\n{chain}\n            w[l] = s\n",
        names,
    )
    many = njit(fastmath=full.FASTMATH, nogil=True)(names["many"])
    w, calls = np.ones(CELLS), 1_000_000
    many(w, 1, 0.5, 0.5)
    seconds = []
    for _ in range(repeats):
        begin = time.process_time()
        many(w, calls, 0.5, 0.5)
        seconds.append(time.process_time() - begin)
    return CHAIN * CELLS * calls / min(seconds)


THROUGHPUT = [
    ("dop853", 1e-6),
    ("dop853", 1e-9),
    ("dop853", 1e-12),
    ("verner98", 1e-9),
    ("dopri5", 1e-9),
]


def show_throughput(quick):
    """Steps of a real mix of runs, as a table for the docs."""
    heading()
    repeats = 3 if quick else 7
    runs = peer_work.draw(6 if quick else 60)
    threads = (1, 2) if numba.config.NUMBA_NUM_THREADS > 1 else (1,)
    top = peak(repeats)
    load = os.getloadavg()[0] if hasattr(os, "getloadavg") else float("nan")
    click.echo(
        f"{len(runs)} runs, medians of {repeats}, load {load:.1f}; one thread can do "
        f"{top / 1e9:.1f}e9 fused multiply-adds a second\n"
    )
    click.echo(
        "| method, `tol` | tried, million/s | accepted, million/s | rejected | products a "
        "step | of the FMA peak | 2 threads over 1 |"
    )
    click.echo("|---|---|---|---|---|---|---|")
    for method, tol in THROUGHPUT:
        seconds, spent = {count: [] for count in threads}, []
        for repeat in range(repeats + 1):
            for count in threads:
                begin, cpu = time.perf_counter(), time.process_time()
                out = integrate(runs, METHODS[method], FULL, tol=tol, threads=count)
                if repeat:
                    seconds[count].append(time.perf_counter() - begin)
                    spent.append(time.process_time() - cpu) if count == 1 else None
        # From processor times, which other work on the machine hardly changes.
        one = statistics.median(spent)
        accepted, rejected = int(out.n_steps.sum()), int(out.n_rejected.sum())
        tried = accepted + rejected
        count = products(METHODS[method])
        gain = (
            f"{statistics.median(seconds[1]) / statistics.median(seconds[2]):.2f}"
            if 2 in seconds
            else ""
        )
        click.echo(
            f"| `{method}`, {tol:.0e} | {tried / one / 1e6:.1f} | {accepted / one / 1e6:.1f} "
            f"| {rejected / tried:.1%} | {count or ''} "
            f"| {f'{count * tried / one / top:.0%}' if count else ''} | {gain} |"
        )


@click.command()
@click.option(
    "--lanes", "by_lanes", is_flag=True, help="The step alone, by number of lanes."
)
@click.option(
    "--throughput", is_flag=True, help="Steps and share of the peak, as Markdown."
)
@click.option("--quick", is_flag=True, help="Shorter and fewer measurements.")
def main(by_lanes: bool, throughput: bool, quick: bool) -> None:
    """Measure the lane kernels against plain scalar code."""
    show = show_lanes if by_lanes else show_throughput if throughput else show_kernels
    show(quick)


if __name__ == "__main__":
    main()
