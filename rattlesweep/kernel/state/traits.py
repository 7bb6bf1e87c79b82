"""What the loop that all models share needs to know of a model, as numbers."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from rattlesweep.kernel.state.lane import Problem
    from rattlesweep.motion.model import Model


class Traits(NamedTuple):
    """Traits of a model and a method.

    Rows of a lane are those of a model's fields (`fields.Layout`), or `fields.NO_ROW`
    for what the model lacks.  Rows at the end of a step are ``n_end`` behind those at
    its start.
    """

    adaptive: bool  # the method controls its steps
    n_fields: int  # rows of the fields of a lane
    n_state: int  # numbers of the state
    n_end: int  # of all that a lane has at either end of a step
    n_probe: int
    n_constants: int  # without the coefficient of friction
    n_results: int  # that modes add to those of a run
    y: int  # first row of the state at the start of a step
    f: int  # of its derivative
    slip: int
    probe: int
    constants: int
    mu: int  # row of the coefficient of friction, the last constant in tables of runs
    sense: int  # row of the sense of the spin
    results: int  # first row of the results that modes add
    kept: int  # first row of the end of a step that is kept
    starts_kept: int  # first row of the starts of steps that are searched later
    limited: bool  # the motion has a limit, at which a run may end
    lifts: bool  # the body may leave the plane, and gains energy from it
    schedules: bool  # lanes may wait for a turn that more lanes share
    advances: bool  # its modes or tangents move something from step to step
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
        n_constants=model.n_constants,
        n_results=at.stages - at.results,
        y=at.y,
        f=at.f,
        slip=at.row_of("slip"),
        probe=at.probe,
        constants=at.constants,
        mu=at.row_of("mu"),
        sense=at.row_of("sense"),
        results=at.results,
        kept=at.kept,
        starts_kept=at.y_of_ratio,
        limited=problem.modes.limited,
        lifts=bool(model.lifts),
        schedules=problem.modes.schedules,
        advances=problem.modes.advances or model.n_tangents > 0,
        has_tangents=model.n_tangents > 0,
        has_frame=model.n_tangents > 1,
    )
