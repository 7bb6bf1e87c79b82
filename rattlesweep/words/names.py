"""Words that name a choice in configs, in commands and in Python, each list once.

They are types, for those who check types, and tuples.  Methods are named in
:mod:`rattlesweep.kernel.method.tableau`, quantities in
:mod:`rattlesweep.words.quantities`.
"""

from typing import Literal, get_args

from rattlesweep.words.watched import ExtremeName, ExtremeWord, MarkName

ModelName = Literal["full", "reduced", "gh"]
PresetName = Literal["GH", "KL"]
AccuracyName = Literal["draft", "standard", "reference"]
PlotName = Literal[
    "fractions",
    "times",
    "ratio",
    "map",
    "reversals",
    "regimes",
    "distribution",
    "scatter",
]
ExportFormat = Literal["mjcf", "json"]
BranchParameter = Literal["energy", "alpha", "beta", "gamma", "theta", "phi", "xi"]
RecordName = Literal[
    "energy",
    ExtremeWord,
    "windows",
    "lyapunov",
    "spectrum",
    "volume",
    MarkName,
    "late",
    "casimir",
    "error",
    "reversals",
]
RefineName = Literal[
    "t_end",
    "t_r",
    "type",
    "n_end",
    "n_steps",
    "energy_drift",
    "amp_growth",
    "n_departure",
    "t_held",
    "held_time",
    "pivot_work",
    "creep_work",
    "slip_work",
    "base_work",
    "t_slide",
    "n_slides",
    "slide_time",
    "slide_work",
    ExtremeName,
    "lyapunov",
    "kaplan_yorke",
    "regime",
    MarkName,
    "n_late_mean",
    "n_late_std",
    "n_turns",
]
DocumentName = Literal["body", "contact", "plan", "status", "verdict"]
RegimeName = Literal[
    "steady", "periodic", "quasi-periodic", "attractor", "conservative", "undecided"
]

MODEL_NAMES: tuple[ModelName, ...] = get_args(ModelName)
PRESET_NAMES: tuple[PresetName, ...] = get_args(PresetName)
ACCURACY_NAMES: tuple[AccuracyName, ...] = get_args(AccuracyName)
PLOT_NAMES: tuple[PlotName, ...] = get_args(PlotName)
EXPORT_FORMATS: tuple[ExportFormat, ...] = get_args(ExportFormat)
BRANCH_PARAMETERS: tuple[BranchParameter, ...] = get_args(BranchParameter)
DOCUMENT_NAMES: tuple[DocumentName, ...] = get_args(DocumentName)
"""Commands whose output by ``--json`` has a JSON Schema."""

RECORDABLE: tuple[RecordName, ...] = get_args(RecordName)
"""Words of `record`, in the order of the columns."""

REFINABLE: tuple[RefineName, ...] = get_args(RefineName)
"""Columns that `bodies.refine.by` may compare."""

REGIMES: tuple[RegimeName, ...] = get_args(RegimeName)
