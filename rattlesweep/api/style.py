"""The style of the figures of rattlesweep, for figures of your own.

Stability: may change.

>>> from rattlesweep.api.style import BLUE, new_figure, save_figure, styled
"""

from rattlesweep.analysis.room import (
    check_panels,
    chosen_size,
    separate_ticks,
    sized,
    with_room,
)
from rattlesweep.analysis.style import (
    BLUE,
    FAINT,
    GREEN,
    GREY,
    ORANGE,
    SERIES,
    SKY,
    THEORY,
    TYPE_STYLE,
    VERMILION,
    add_legend,
    local_numbers,
    new_figure,
    save_figure,
    save_table,
    styled,
    thin,
    value_text,
)

__all__ = [
    "BLUE",
    "FAINT",
    "GREEN",
    "GREY",
    "ORANGE",
    "SERIES",
    "SKY",
    "THEORY",
    "TYPE_STYLE",
    "VERMILION",
    "add_legend",
    "check_panels",
    "chosen_size",
    "local_numbers",
    "new_figure",
    "save_figure",
    "save_table",
    "separate_ticks",
    "sized",
    "styled",
    "thin",
    "value_text",
    "with_room",
]
