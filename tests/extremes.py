"""The extremes: a named table of cases, and the product's answers to them.

A case goes the way of a sweep: a row of a table of bodies, a config, a block.
"""

import math
import tempfile
import time
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from unittest import mock

import numpy as np
import pandas as pd
from reference import PARAMETERS

from rattlesweep.sweep import blocks
from rattlesweep.sweep.config import parse_config
from rattlesweep.sweep.plan import make_plan
from rattlesweep.sweep.types import TYPES

GH = {"alpha": 13.04, "beta": 1.522, "gamma": 12.28, "theta": 0.6429, "phi": 0.036,
      "xi": -math.radians(1.72)}  # fmt: skip


def shell_dumbbell(gamma=10.0, f_sd=0.1, theta=0.8, phi=0.05, xi=-3.0):
    """A shell-dumbbell body, xi in degrees."""
    return {"alpha": (1 - f_sd) * gamma + 1, "beta": f_sd * gamma + 1, "gamma": gamma,
            "theta": theta, "phi": phi, "xi": math.radians(xi)}  # fmt: skip


@dataclass(frozen=True)
class Case:
    """One run at an extreme."""

    name: str
    body: dict
    n_i: float
    omega_xy0: float = 0.01
    t_end: float = 100.0
    method: dict = field(default_factory=lambda: {"tol": 1e-9})


@dataclass
class Answer:
    """What the product says of a case: columns of ``runs`` and the state at the end."""

    row: dict
    y_end: np.ndarray
    probe: np.ndarray
    seconds: float

    def __getattr__(self, name):
        return self.row[name]


@contextmanager
def _outcomes():
    """Keep what `run_batch` returns, so that the state at the end can be seen."""
    kept, original = [], blocks.run_batch

    def keep(*args, **options):
        kept.append((args[1], original(*args, **options)))
        return kept[-1][1]

    with mock.patch.object(blocks, "run_batch", keep):
        yield kept


def ask(cases, integrator=None, record=(), max_steps=100_000_000):
    """Run cases as one block; ``integrator`` as in a config."""
    frame = pd.DataFrame(
        [{**c.body, "n_i": c.n_i, "omega_xy0": c.omega_xy0, "t_end": c.t_end} for c in cases],
        dtype=float,
    )
    with tempfile.TemporaryDirectory() as place:
        path = Path(place) / "cases.parquet"
        frame.to_parquet(path)
        config = parse_config({
            "bodies": {"source": "table", "path": str(path)},
            "spin": {"n_i": [1.0], "omega_xy0": [1.0]},
            "horizon": {"t": 1.0},
            "integrator": {**(integrator or {}), "max_steps": max_steps},
            "record": list(record),
        })  # fmt: skip
        plan = make_plan(config)
    with _outcomes() as kept:
        launches, batch = blocks.prepare_block(plan, plan.block(0))
        begin = time.perf_counter()
        columns = blocks.finish_block(config, launches, batch, threads=1)
        seconds = time.perf_counter() - begin
    batch, outcome = kept[0]
    answers = []
    codes, status = columns["type"][0], columns["status"]
    for k, case in enumerate(cases):
        for name in (*PARAMETERS, "n_i", "omega_xy0"):
            wanted = case.body[name] if name in case.body else getattr(case, name)
            assert columns[name][k] == wanted
        row = {name: value[k].item() for name, value in columns.items()
               if isinstance(value, np.ndarray)}  # fmt: skip
        row["type"] = TYPES[codes[k]] if codes[k] >= 0 else None
        row["status"] = status[1][int(status[0][k])]
        probe = batch.probe[k, :4] + 1j * batch.probe[k, 4:]
        answers.append(Answer(row, outcome.y_end[k], probe, seconds))
    return answers
