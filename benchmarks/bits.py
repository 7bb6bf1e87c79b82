"""Check that a process that compiles a kernel computes the same bits as one that loads
it.

    python benchmarks/bits.py [--only WORDS] [--repeats 3]

It covers all kernels: sweeps, sweeps with a tangent, and trajectories with rows between
their steps, for all methods and models.  Some processes load kernels that helper
processes compiled, as usual; some compile their own; some load what these have left in
the cache.  Sweeps run on one and two threads, and in four threads at once.  Each line
shows the hashes of all results.
"""

from __future__ import annotations

import hashlib
import json
import os
import subprocess
import sys
import tempfile
import threading
from pathlib import Path

import click
import numpy as np

from rattlesweep.integrate import compile
from rattlesweep.integrate.batch import RECORDS, Batch, integrate
from rattlesweep.integrate.follow import Follower
from rattlesweep.integrate.model import MODELS
from rattlesweep.integrate.tableau import METHODS
from rattlesweep.sweeps.config.read import load_config
from rattlesweep.sweeps.launches import make_batch, prepare
from rattlesweep.sweeps.plan import make_plan

HERE = Path(__file__).resolve()
CONFIG = HERE.parent.parent / "configs" / "quickstart.yaml"
TOL, DT = 1e-8, 0.01
PLAIN = ("full", "reduced")
SAMPLES = {"full": 4, "reduced": 16}


def jobs():
    """Return the names of all kernels: kind, method, model."""
    for method in METHODS:
        for model in PLAIN:
            yield "sweep", method, model
            yield "tangent", method, model
            yield "march", method, model


def runs(model):
    """Return launches of all cases of quickstart, with short horizons."""
    settings = [f"bodies.samples={SAMPLES[model]}", f"model={model}"]
    plan = make_plan(load_config(CONFIG, [*settings, "horizon={t_rgh: 5, t: 400}"]))
    case, sample = np.divmod(np.arange(plan.runs), plan.samples)
    batch = make_batch(prepare(plan, case, sample), model)
    assert batch is not None
    return batch


def digest(*arrays):
    """Hash of arrays, to the last bit."""
    found = hashlib.sha256()
    for array in arrays:
        found.update(np.ascontiguousarray(array).tobytes())
    return found.hexdigest()[:12]


def swept(batch, method, model, record, threads):
    """Hash of a sweep."""
    out = integrate(
        batch,
        METHODS[method],
        MODELS[model],
        tol=TOL,
        dt=DT,
        record=frozenset(record),
        threads=threads,
    )
    return digest(*(v for v in vars(out).values() if isinstance(v, np.ndarray)))


def in_threads(call):
    """Return the results of a call made in four threads at once."""
    found = []
    team = [threading.Thread(target=lambda: found.append(call())) for _ in range(4)]
    for thread in team:
        thread.start()
    for thread in team:
        thread.join()
    return found


def followed(batch, method, model):
    """Hash of one run past its reversals, and of rows between its steps."""
    one = Batch(**{name: values[-1:] for name, values in vars(batch).items()})
    follower = Follower(
        one, METHODS[method], MODELS[model], tol=TOL, dt=DT, attitude=model == "full"
    )
    found = follower.at(np.linspace(0.0, float(one.t_end[0]), 1001))
    return digest(found.t, found.y, found.extra, np.array(follower.zeros))


def hashes(job, repeats):
    """Return the hashes of a kernel's results, for every way of calling it."""
    kind, method, model = job
    batch = runs(model)
    if kind == "march":
        return [followed(batch, method, model) for _ in range(repeats)] + in_threads(
            lambda: followed(batch, method, model)
        )
    left_out = {"lyapunov"} if kind == "sweep" or model == "reduced" else set()
    record = {*RECORDS} - left_out - ({"volume"} if model == "reduced" else set())

    def call(threads=1):
        return swept(batch, method, model, record, threads)

    found = [call(threads) for threads in (1, 2) for _ in range(repeats)]
    return [*found, *in_threads(call)]


def compile_here():
    """Make this process compile its own kernels instead of using helper processes."""
    compile._compile = lambda wanted: None


def serve(way, names, repeats):
    """Print one line of JSON for each kernel (runs in a child process)."""
    if way == "here":
        compile_here()
    for name in names:
        print(json.dumps([name, hashes(name.split(), repeats)]), flush=True)


def start(way, place, names, repeats):
    """Start a process that gets its kernels in one way, with a cache of its own."""
    place.mkdir(mode=0o700, exist_ok=True)
    return subprocess.Popen(
        [sys.executable, str(HERE), "--serve", way, "--repeats", str(repeats), *names],
        env=os.environ | {"NUMBA_CACHE_DIR": str(place), "XDG_CACHE_HOME": str(place)},
        stdout=subprocess.PIPE,
        text=True,
    )


@click.command()
@click.argument("names", nargs=-1)
@click.option("--only", default="", help="Only kernels with this in their name.")
@click.option("--repeats", default=3, show_default=True)
@click.option("--serve", "way", hidden=True)
def main(names: tuple[str, ...], only: str, repeats: int, way: str | None) -> None:
    """Compare the bits of compiled and loaded kernels; exit with 1 if some differ."""
    if way:
        serve(way, names, repeats)
        return
    names = tuple(name for name in map(" ".join, jobs()) if only in name)
    found: dict[str, dict[str, list[str]]] = {name: {} for name in names}
    with tempfile.TemporaryDirectory() as home:
        place = Path(home)
        for label, way, cache in (
            ("compiled by a child", "child", "child"),
            ("compiled here", "here", "here"),
            ("loaded from here", "child", "here"),
        ):
            # Two processes at a time, because one kernel does not keep two processors
            # busy.
            parts = [
                start(way, place / f"{cache}{i}", names[i::2], repeats)
                for i in range(2)
            ]
            for process in parts:
                for line in process.stdout:
                    name, values = json.loads(line)
                    found[name][label] = values
                    click.echo(
                        f"{name:26}{label:26}{len(values)} runs {sorted(set(values))}"
                    )
                if process.wait():
                    raise click.ClickException(f"{label}: a process failed")
    differ = 0
    for name, by_label in found.items():
        kinds = {value for values in by_label.values() for value in values}
        differ += len(kinds) > 1
        click.echo(
            f"{name:26}{sum(map(len, by_label.values())):4} runs, {len(kinds)} hash(es)"
        )
    click.echo(f"{differ} of {len(found)} kernels differ")
    sys.exit(1 if differ else 0)


if __name__ == "__main__":
    main()
