"""What nouns bring to a lane and to the results of a run, collected in one place.

A noun declares this beside its code, in classes: ``Fields`` that a lane has for it,
``Results`` that it adds to those of every run, or to those of runs with a mode, and a
``Record`` of what may be recorded of it, with the shape of the table of a run.
"""

from collections import namedtuple
from dataclasses import dataclass
from functools import cache
from typing import get_type_hints

from rattlesweep.kernel import runs, tangents
from rattlesweep.kernel.event import looks, peaks, zeros
from rattlesweep.kernel.look import casimir, extremes, late, marks, put_off
from rattlesweep.kernel.method.collocation import STAGES
from rattlesweep.kernel.mode import modes
from rattlesweep.kernel.state import fields as kinds
from rattlesweep.kernel.state import ways
from rattlesweep.kernel.state.fields import N_SLIP, Layout
from rattlesweep.motion.model import Model

# Fields of every lane, whatever its model.
OF_EVERY_LANE = (
    # In the first rows, where `runs.start` copies it.
    runs.StartFields,
    runs.RunFields,
    zeros.SearchFields,
    peaks.PeakFields,
    looks.LookFields,
    ways.ModeFields,
    extremes.ExtremeFields,
    put_off.PutOffFields,
    marks.MarkFields,
    late.LateFields,
    casimir.CasimirFields,
    # Next to the state.
    kinds.TurnFields,
)


@cache
def layout_of(model: Model | None) -> Layout:
    """Return the rows of the lanes of a model; of None, those that all models share."""
    if model is None:
        return Layout(OF_EVERY_LANE)
    ends: list[type] = [kinds.MotionFields, tangents.TangentFields]
    others: list[type] = [kinds.BodyFields]
    brought = modes.nouns_of(model)
    ends += brought.ends
    others += brought.others
    if model.n_tangents:
        others.append(tangents.GrowthFields)
    others.append(put_off.KeptStartFields)
    # One tangent needs none.
    n_lengths = model.n_tangents
    if n_lengths == 1:
        n_lengths = 0
    counts = {
        kinds.State: model.n_state,
        kinds.Constants: model.n_constants,
        kinds.Probe: model.n_probe,
        kinds.Tangent: model.n_tangents * model.n_state,
        kinds.Lengths: n_lengths,
        kinds.Past: STAGES * (model.n_state + N_SLIP),
    }
    places = modes.places_of(model)
    parts = {name: ("constants", place) for name, place in places.items()}
    return Layout(OF_EVERY_LANE, ends, others, brought.results, counts, parts)


# Types of the numbers in arrays of the results of modes, by name.
MODE_RESULTS = {
    name: runs.NUMBER_OF[kind]
    for name, kind in get_type_hints(modes.ModeResults).items()
}


@dataclass(frozen=True)
class Recorded(
    runs.RunRecord,
    extremes.ExtremeRecord,
    marks.MarkRecord,
    late.LateRecord,
    casimir.CasimirRecord,
    tangents.GrowthRecord,
):
    """What is recorded of runs: arrays of shape (runs, rows, columns).

    An array has no runs if its observation is not recorded.
    """


# Rows and columns of the table of a run, by name.
SHAPES = {
    name: kind.__metadata__[0]
    for name, kind in get_type_hints(Recorded, include_extras=True).items()
}
Recording = namedtuple("Recording", SHAPES)  # type: ignore[misc]
"""What a kernel records: the arrays of :class:`Recorded`."""
