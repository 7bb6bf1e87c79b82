"""`rattlesweep compile`: kernels ahead of their first use."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import click
from click import argument, option

from rattlesweep.cli.common import command, say, types
from rattlesweep.errors import OutputError

if TYPE_CHECKING:
    from rattlesweep.sweeps.config.schema import Config

SWEEP = {"bodies": {"source": "sd", "samples": 1}, "spin": {"n_i": 0.1, "omega_xy0": 0.01}}


@command("Sweeps", "rattlesweep compile --all", "rattlesweep compile configs/steady.yaml")
@argument("configs", metavar="[CONFIG]...", type=click.Path(path_type=Path), nargs=-1)
@option("--all", "everything", is_flag=True, help="All that the commands need with the methods, "
        "models and records there are.")  # fmt: skip
def compile(configs: tuple[Path, ...], everything: bool) -> None:
    """Compile kernels ahead, as for an image or on a login node.

    Those of the sweeps of CONFIG, by default of one with the default method and model. Prints one
    line per kernel: the seconds it took, or that it was there. Removes kernels that other versions
    have left.
    """
    from rattlesweep.integrate.cache import KernelCache, directory, remove_old
    from rattlesweep.integrate.lanes import kernel
    from rattlesweep.sweeps.config.read import load_config, parse_config

    sweeps = [load_config(path) for path in configs] or [parse_config(SWEEP)]
    place = directory(kernel.__file__)
    if place is None:
        raise OutputError("there is no directory in which kernels can be kept: set XDG_CACHE_HOME "
                          "or NUMBA_CACHE_DIR to one that only you can write")  # fmt: skip
    kernels = {name: load for config in sweeps for name, load in _of_sweep(config)}
    if everything:
        kernels |= dict(_all())
    for name, load in kernels.items():
        before, start = KernelCache.compilations, time.monotonic()
        load()
        seconds = f"{time.monotonic() - start:.1f} s"
        there = KernelCache.compilations == before
        click.echo(f"{name:<28}  {'already there' if there else seconds}")
    if removed := remove_old(place):
        say(f"removed: {removed} directories of other versions in {place.parent}")


Kernels = Iterator[tuple[str, Callable[[], object]]]


def _of_sweep(config: Config) -> Kernels:
    """What a sweep needs, by name, and what loads it; the closed form needs no kernel."""
    import numpy as np

    from rattlesweep.sweeps.block import load_kernel
    from rattlesweep.sweeps.bodies.sampler import draw_bodies

    if config.bodies.source == "sd":
        yield "bodies", partial(draw_bodies, 0, np.zeros(1, dtype=np.int64), np.ones((5, 2)))
    if config.model != "gh":
        tangent = " lyapunov" if "lyapunov" in config.record else ""
        name = f"sweep {config.integrator.method} {config.model}{tangent}"
        yield name, partial(load_kernel, config)


def _all() -> Kernels:
    """Those of the trade-off study, of the paper and of trajectories."""
    from rattlesweep.integrate.follow.kernels import ATTITUDES, load_all
    from rattlesweep.integrate.tableau import DOP853, METHODS
    from rattlesweep.sweeps.config.read import parse_config

    for method in METHODS:
        yield from _of_sweep(parse_config(SWEEP | {"integrator": {"method": method}}))
    for model in types.MODELS.choices:
        yield from _of_sweep(parse_config(SWEEP | {"model": model}))
    yield from _of_sweep(parse_config(SWEEP | {"record": ["lyapunov"]}))
    for model in ("full", "reduced"):
        name = f"trajectory {DOP853.name} {model}"
        yield name, partial(load_all, DOP853.name, model, model in ATTITUDES)
