"""What the tests of kernels do in fresh processes; imports little."""

from __future__ import annotations

import json
import multiprocessing
from concurrent.futures import ThreadPoolExecutor

import kernels
import numba
import numpy as np
import oracle

from rattlesweep.kernel.batch import integrate
from rattlesweep.kernel.follow import Follower
from rattlesweep.kernel.method.tableau import METHODS
from rattlesweep.motion.model import FULL


def states() -> str:
    batch = kernels.full_batch(oracle.GH, [0.1, -0.2, 0.3], t_end=50.0)
    out = integrate(batch, METHODS["dop853"], FULL, tol=1e-5, threads=2)
    return json.dumps([out.y_end.tobytes().hex(), out.n_steps.tolist()])


def _states(_: int) -> str:
    return states()


def fork(layer: str) -> None:
    """Integrate in threads and then in forked processes."""
    before = states()
    assert numba.threading_layer() == layer
    with ThreadPoolExecutor(4) as threads:
        assert set(threads.map(lambda _: states(), range(40))) == {before}
    with multiprocessing.get_context("fork").Pool(2) as workers:
        assert workers.map(_states, range(4)) == [before] * 4
    assert states() == before


def both() -> str:
    """Return a run with records and its trajectory, as JSON."""
    batch = kernels.full_batch(oracle.GH, [-0.1], 0.01, t_end=10.0)
    records = frozenset(["energy", "contact", "windows", "reversals"])
    out = integrate(batch, METHODS["dop853"], FULL, threads=1, record=records)
    follower = Follower(batch, METHODS["dop853"], FULL, attitude=True)
    samples = follower.at(np.linspace(0.0, 10.0, 7))
    values = out.y_end, out.n_departure, out.windows, samples.y, samples.extra
    numbers = np.concatenate([value[np.isfinite(value)] for value in values])
    return json.dumps([numbers.tolist(), out.n_steps.tolist(), follower.n_steps])
