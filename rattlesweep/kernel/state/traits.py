"""What the loop that all models share needs to know of a model, as numbers."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from rattlesweep.kernel.state.lane import Problem
    from rattlesweep.motion.model import Model


class Traits(NamedTuple):
    """Traits of a model and a method.

    The fields of a lane that depend on the model begin with those at the start of a
    step, its state and derivative first and its slip last; as many rows with those at
    its end follow, and then the probe and the constants (`fields.Layout`).
    """

    adaptive: bool  # the method controls its steps
    n_fields: int  # rows of the fields of a lane
    n_state: int  # numbers of the state
    n_end: int  # of the state, its derivative, tangents and theirs, and the slip
    n_probe: int
    n_constants: int  # with the coefficient of friction
    kept: int  # first row of the end of a step that is kept
    results: int  # first row of what modes add to the results of a run, the last rows
    limited: bool  # the motion has a limit, at which a run may end
    lifts: bool  # the body may leave the plane, and gains energy from it
    slides: bool
    pivots: bool
    has_tangents: bool
    has_frame: bool  # of tangents, with which a run goes on after a reversal


def traits_of(problem: Problem, model: Model, *, adaptive: bool) -> Traits:
    """Return the traits of a model, whose problem may have a rim."""
    at = problem.layout
    return Traits(
        adaptive=adaptive,
        n_fields=at.stages,
        n_state=model.n_state,
        n_end=at.second - at.first,
        n_probe=model.n_probe,
        n_constants=len(model.of_runs),
        results=at.results,
        kept=at.kept,
        limited=problem.limited,
        lifts=bool(model.lifts),
        slides=problem.slides,
        pivots=problem.pivots,
        has_tangents=model.n_tangents > 0,
        has_frame=model.n_tangents > 1,
    )
