"""What is noted of accepted steps and needs a model: late spins, the Casimir invariant.

:func:`note_step` is a part that is compiled for each model and called by its address
(`kernel.turn`), and only loaded where one of them is recorded.
"""

# mypy: ignore-errors
from rattlesweep.kernel.look import late
from rattlesweep.kernel.look.casimir import note_casimir, store_casimir
from rattlesweep.kernel.state.lane import lane_of


def note_step(problem, w, l, late_counts, casimir_counts, ends, casimir):
    """Let the step just taken on lane ``l`` count, and store what is known at its end.

    ``late_counts`` and ``casimir_counts`` say of what; ``ends``, whether the run ends
    and its Casimir invariant is to be stored in ``casimir``.
    """
    lane = lane_of(problem, w, l)
    if late_counts:
        late.note(lane)
    if casimir_counts:
        note_casimir(lane, casimir)
    if ends:
        store_casimir(lane, casimir)
