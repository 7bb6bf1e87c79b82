"""Words that name a choice in configs, in commands and in Python, each list once.

They are types, for those who check types, and tuples.  Methods are named in
:mod:`rattlesweep.integrate.tableau`, quantities in :mod:`rattlesweep.quantities`.
"""

from typing import Literal, get_args

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
RegimeName = Literal[
    "steady", "periodic", "quasi-periodic", "attractor", "conservative", "undecided"
]

MODEL_NAMES: tuple[ModelName, ...] = get_args(ModelName)
PRESET_NAMES: tuple[PresetName, ...] = get_args(PresetName)
ACCURACY_NAMES: tuple[AccuracyName, ...] = get_args(AccuracyName)
PLOT_NAMES: tuple[PlotName, ...] = get_args(PlotName)
EXPORT_FORMATS: tuple[ExportFormat, ...] = get_args(ExportFormat)
REGIMES: tuple[RegimeName, ...] = get_args(RegimeName)
