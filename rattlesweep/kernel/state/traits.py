"""What the loop that all models share needs to know of a model, as numbers."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from rattlesweep.kernel.state.lane import Problem
    from rattlesweep.motion.model import Model


class Traits(NamedTuple):
    """Traits of a model and a method.

    The fields of a lane that depend on the model begin with those at the start of a
    step; as many rows with those at its end follow, and then the constants and the
    probe (`fields.Fields`).
    """

    adaptive: bool  # the method controls its steps
    n_fields: int  # rows of the fields of a lane
    n_state: int  # numbers of the state
    n_end: int  # of the state, its derivative, tangents and theirs
    n_constants: int
    n_probe: int
    limited: bool  # the motion has a limit, at which a run may end
    lifts: bool  # the body may leave the plane, and gains energy from it
    slides: bool
    pivots: bool
    has_tangents: bool
    has_frame: bool  # of tangents, with which a run goes on after a reversal


def traits_of(problem: Problem, model: Model, *, adaptive: bool) -> Traits:
    """Return the traits of a model, whose problem may have a rim."""
    return Traits(
        adaptive=adaptive,
        n_fields=problem.layout.stages,
        n_state=model.n_state,
        n_end=2 * (1 + model.n_tangents) * model.n_state,
        n_constants=model.n_constants,
        n_probe=model.n_probe,
        limited=problem.limited,
        lifts=bool(model.lifts),
        slides=problem.slides,
        pivots=problem.pivots,
        has_tangents=model.n_tangents > 0,
        has_frame=model.n_tangents > 1,
    )
