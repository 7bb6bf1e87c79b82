"""The kernels that the figures need, compiled side by side while what needs none is drawn."""

from __future__ import annotations

from collections.abc import Callable, Collection
from functools import partial
from typing import Any

from rattlesweep.integrate.follow import lyapunov
from rattlesweep.integrate.follow.kernels import aside_kernel, march_kernel
from rattlesweep.integrate.lanes.build import kernel
from rattlesweep.integrate.loading import AT_ONCE, loaded
from rattlesweep.integrate.model import FULL, REDUCED, WITH_TANGENT
from rattlesweep.integrate.task import Control, Task, side_by_side
from rattlesweep.paper.figures import integrators

TANGENT = WITH_TANGENT[FULL.name].name


def needed(figures: Collection[str]) -> list[Callable[[Any], Any]]:
    """What loads the kernels of some figures, in the order in which they come to be needed."""
    kernels: list[tuple[str, Callable[..., Any], str, str]] = [
        ("fig4 fig5 fig6 fig8", march_kernel, "dop853", FULL.name),
        ("fig4 fig5 fig6 fig8", aside_kernel, "dop853", FULL.name),
        ("fig5 fig6 fig7", kernel, "dop853", FULL.name),
        ("fig6", kernel, "dop853", TANGENT),
        ("fig6", kernel, integrators.PAPERS["method"], FULL.name),
        ("fig8", march_kernel, "dop853", REDUCED.name),
        ("fig8", aside_kernel, "dop853", REDUCED.name),
        ("fig8_lyapunov", partial(loaded, lyapunov.example), "dop853", TANGENT),
    ]

    def load(make: Callable[..., Any], method: str, model: str, _: Control) -> None:
        make(method, model)

    return [
        partial(load, make, method, model)
        for users, make, method, model in kernels
        if {*users.split()} & {*figures}
    ]


def compile_ahead(figures: Collection[str]) -> None:
    """Begin to load the kernels of some figures, in threads of their own.

    Who needs one meanwhile waits for it: each is compiled once.
    """
    calls = needed(figures)
    if calls:
        Task(lambda _: side_by_side(calls, AT_ONCE))
