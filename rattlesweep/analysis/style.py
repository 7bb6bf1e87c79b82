"""The look of every picture: colours, marks, symbols, units, legends, and the files
written.
"""

import io
import math
import re
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib as mpl
import numpy as np
import pandas as pd
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullFormatter

from rattlesweep.arrays import Floats, Places
from rattlesweep.errors import ConfigError, one_line
from rattlesweep.sweeps.columns import MEASURED, RUNS
from rattlesweep.sweeps.files import replace_file

# The palette of Okabe and Ito, which colour-blind readers can tell apart.
BLUE, VERMILION, GREEN = "#0072B2", "#D55E00", "#009E73"
PURPLE, ORANGE, SKY = "#CC79A7", "#E69F00", "#56B4E9"
BLACK, INK, GREY, SILVER, FAINT = "#000000", "#222222", "#555555", "#A6A6A6", "#e4e4e4"
FAILED, MISSING, NO_REVERSAL = BLACK, "#FFFFFF", "#F3D9D2"


class Mark(NamedTuple):
    """The look of a type of run, which a marker and a hatch identify without colour."""

    colour: str
    marker: str
    hatch: str
    label: str


TYPE_STYLE = {
    "R": Mark(BLUE, "o", "", "R: reverses"),
    "SW": Mark(ORANGE, "s", "////", "SW: wobbles"),
    "unclassified": Mark(SILVER, "x", "....", "unclassified"),
    "SS": Mark(GREEN, "^", "\\\\\\\\", "SS: steady spinning"),
    "D": Mark(PURPLE, "v", "xxxx", "D: dies"),
}
SERIES = (
    (BLUE, "o"),
    (VERMILION, "s"),
    (GREEN, "^"),
    (PURPLE, "D"),
    (ORANGE, "v"),
    (SKY, "P"),
    (BLACK, "X"),
    ("#8A8A8A", "*"),
)
THEORY: dict[str, Any] = {"color": INK, "linestyle": (0, (4, 2)), "linewidth": 1.1}

# Units of columns as formulas.
UNITS = {
    "1": "",
    "sqrt(a/g)": r"$\sqrt{a/g}$",
    "sqrt(g/a)": r"$\sqrt{g/a}$",
    "deg": "degrees",
    "a": "$a$",
    "M g a": r"$M\,g\,a$",
    "M g": r"$M\,g$",
    "M a^2 sqrt(g/a)": r"$M\,a^2 \sqrt{g/a}$",
}
# Symbols of columns whose names are not a letter and an index.
SYMBOLS = {
    "phi": r"$\varphi$",
    "minus_xi_deg": r"$-\xi$",
    "rolling": "$l$",
    "t_rgh": "$t_{rGH}$",
    "ratio": r"$t_r/t_{rGH}$",
    "t": "time",
    "n": "spin $n$",
    "n_turns": "number of turns",
    "reversals_sure": "number of confirmed turns",
}
# Ends of names that are units.
SUFFIXES = {"_rpm": "rpm", "_N_m_s": "N m s", "_s": "s", "_m": "m", "_deg": "deg"}
LETTERS = r"(alpha|beta|gamma|theta|xi|sigma|omega|[A-Za-z])(?:_(\w{1,3}))?"

RC: dict[str, Any] = {
    "font.size": 9,
    "axes.linewidth": 0.6,
    "axes.axisbelow": True,
    "axes.formatter.useoffset": False,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "legend.frameon": False,
    "hatch.linewidth": 0.5,
    "hatch.color": "#00000066",
    "svg.fonttype": "path",
    "svg.hashsalt": "rattlesweep",
    "pdf.fonttype": 42,
}
# File formats, without the metadata that would make two equal figures differ.
FORMATS = {
    "svg": {"Date": None},
    "png": {"Software": None},
    "pdf": {"CreationDate": None},
}

DPI = 150.0
ROUNDING = (
    1e-9  # steps below this part of a curve's range are not counted as oscillations
)
BINS = 1000  # stretches of a curve, each about a pixel wide
MOST_PERIODS = (
    150  # a curve of more oscillations would be a slab of ink: its envelope is drawn
)


@contextmanager
def styled(style: Path | None = None) -> Iterator[None]:
    """Draw with the settings of all pictures, overridden by those of a style file."""
    settings = mpl.RcParams(RC)
    try:
        if style is not None:
            settings |= mpl.rc_params_from_file(str(style), True, False)
    except OSError as error:
        raise ConfigError(
            f"--style {style}: {error.strerror}; give the path of a style file of "
            "Matplotlib"
        ) from None
    except ValueError as error:
        raise ConfigError(f"--style {style}: {one_line(str(error), 300)}") from None
    with mpl.rc_context():
        mpl.rcdefaults()
        mpl.rcParams.update(settings)
        yield


def new_figure(width: float, height: float) -> Figure:
    """Return a figure of a size in inches; without pyplot there is no window or global
    state.
    """
    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def add_legend(figure: Any, handles: list[Any], heading: Sequence[str] = ()) -> None:
    """Put heading lines and a legend above all panels, in as few rows as the width
    allows.
    """
    count = max(1, len(handles))
    for rows in range(1, count + 1):
        legend = figure.legend(
            handles=handles,
            loc="outside upper center",
            columnspacing=1.4,
            ncols=math.ceil(count / rows),
        )
        if rows == count or legend.get_window_extent().width <= figure.bbox.width:
            break
        legend.remove()
    legend.set_title("\n".join(map(str, heading)) or None)
    legend.get_title().set_multialignment("center")


def add_caption(figure: Figure, words: str, *, grow: bool = True) -> None:
    """Write sentences below all panels; with `grow`, enlarge the figure by their
    height.
    """
    size = 7.0
    lines = textwrap.wrap(
        words.replace("$", "\\$"), int(1.75 * 72 * figure.get_figwidth() / size)
    )
    figure.supxlabel("\n".join(lines), fontsize=size, color=GREY, multialignment="left")
    if grow:
        figure.set_figheight(figure.get_figheight() + 0.02 * size * len(lines))


def light_grid(axes: Any) -> None:
    """Draw a faint grid behind the data, and no frame on the top and the right."""
    axes.grid(visible=True, color=FAINT, linewidth=0.6)
    axes.spines[["top", "right"]].set_visible(False)


def entry(words: str, **look: Any) -> Line2D:
    """Return a legend entry."""
    return Line2D([], [], label=words, **{"linestyle": "", **look})


def scale_axis(
    axes: Any, which: str, values: Any, log: bool, name: str = "t_r"
) -> None:
    """Make an axis logarithmic if `log`; `name` is that of its values in the error
    message.
    """
    if log:
        if np.min(values) <= 0:
            raise ConfigError(
                f"--log: {name} has values that are not positive; leave it out"
            )
        getattr(axes, f"set_{which}scale")("log")
        plain_ticks(axes, which, float(np.min(values)), float(np.max(values)))


class PlainTicks(LogLocator):
    """Ticks at 1, 2, 5 or other multiples of the powers of ten, as there is room
    for.
    """

    def tick_values(self, vmin: float, vmax: float) -> Any:
        """Return the ticks between two ends."""
        axis: Any = self.axis
        for subs in ((1.0, 2.0, 5.0), (1.0, 3.0), (1.0, 1.5, 2.0, 3.0, 5.0, 7.0)):
            self.set_params(subs=subs)
            ticks = np.asarray(super().tick_values(vmin, vmax))
            shown = np.count_nonzero((ticks >= vmin) & (ticks <= vmax))
            if 3 <= shown <= axis.get_tick_space():
                return ticks
        self.set_params(subs=(1.0,))
        return super().tick_values(vmin, vmax)


def plain_ticks(axes: Any, which: str, low: float, high: float) -> None:
    """Label a logarithmic axis from `low` to `high` with plain numbers instead of
    powers.
    """
    axis = getattr(axes, f"{which}axis")
    axis.set_major_locator(PlainTicks() if high > 4 * low else MaxNLocator(4))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())


def thin(values: Floats, bins: int) -> Places:
    """Return the indices of both ends and of the extremes in each of `bins`
    stretches.
    """
    places = np.arange(len(values))
    if len(values) <= 2 * bins:
        return places
    extremes = [
        part[[values[part].argmin(), values[part].argmax()]]
        for part in np.array_split(places, bins)
    ]
    return np.union1d(extremes, places[[0, -1]])


def curve(
    axis: Any, t: Floats, values: Floats, colour: str = BLUE, **look: Any
) -> None:
    """Draw a curve, or the envelope of one with very many oscillations."""
    look = {"color": colour, "linewidth": 0.8} | look
    steps = np.diff(values)
    steps = steps[np.abs(steps) > ROUNDING * np.ptp(values)]
    periods = np.count_nonzero(np.diff(np.sign(steps))) / 2
    if periods <= MOST_PERIODS or not np.isfinite(values).all():
        places = thin(values, BINS)
        axis.plot(t[places], values[places], **look)
        return
    starts = np.linspace(0, len(t), int(min(BINS, periods / 1.5)) + 1).astype(np.int64)[
        :-1
    ]
    low, high = np.minimum.reduceat(values, starts), np.maximum.reduceat(values, starts)
    middle = t[(starts + np.append(starts[1:], len(t)) - 1) // 2]
    middle[0], middle[-1] = t[0], t[-1]
    axis.fill_between(middle, low, high, color=colour, alpha=0.25, linewidth=0)
    for edge in (low, high):
        axis.plot(middle, edge, **look)
        look.pop("label", None)


def encode(figure: Figure, kind: str, dpi: float = DPI) -> bytes:
    """Return the bytes of a figure in one of `FORMATS`; equal figures give equal
    bytes.
    """
    buffer = io.BytesIO()
    try:
        figure.savefig(buffer, format=kind, dpi=dpi, metadata=FORMATS[kind])
    except ValueError as error:  # an invalid formula in a title
        raise ConfigError(
            f"a text in the picture: {' '.join(str(error).split())}"
        ) from None
    return buffer.getvalue()


def save(figure: Figure, paths: Sequence[Path], dpi: float = DPI) -> None:
    """Write a figure to files atomically, in the formats of their endings."""
    for path in paths:
        kind = path.suffix.lower().removeprefix(".")
        if kind not in FORMATS:
            raise ConfigError(
                f"path {path}: the name must end in .{', .'.join(FORMATS)}"
            )
        replace_file(path, encode(figure, kind, dpi))


def save_table(rows: pd.DataFrame, path: Path) -> None:
    """Write a table atomically, as CSV or Parquet by the ending."""
    csv = path.suffix.lower() == ".csv"
    replace_file(
        path, rows.to_csv(index=False).encode() if csv else rows.to_parquet(index=False)
    )


def text_table(rows: Sequence[Mapping[Any, Any]], form: str = ".6g") -> str:
    """Return rows as a table of text, without the columns that are empty."""
    frame = pd.DataFrame(rows).dropna(axis=1, how="all").astype(object)
    frame = frame.where(frame.notna(), "-")
    return frame.to_string(index=False, float_format=lambda x: f"{x:{form}}")


def symbol(name: str) -> str:
    """Return the symbol of a quantity; ``omega_p`` is a letter with an index."""
    name = name if name in SYMBOLS else _split(name)[0]
    if name in SYMBOLS or not (found := re.fullmatch(LETTERS, name)):
        return SYMBOLS.get(name, name)
    letter = f"\\{found[1]}" if len(found[1]) > 1 else found[1]
    return f"${letter}_{{{found[2]}}}$" if found[2] else f"${letter}$"


def label(name: str, unit: str | None = None) -> str:
    """Return the symbol of a quantity and its unit in brackets, by default that of its
    column.
    """
    if unit is None:
        known = {
            column.name: column
            for part in (*RUNS.values(), MEASURED)
            for column in part
        }
        unit = (
            known[name].metadata[b"unit"].decode() if name in known else _split(name)[1]
        )
    shown = UNITS.get(unit, unit)
    return f"{symbol(name)} ({shown})" if shown else symbol(name)


def value_text(name: str, value: float) -> str:
    """Return a text such as ``n_i = -0.1`` or ``n_i = -60 rpm``."""
    return f"{symbol(name)} = {value:.4g} {_split(name)[1]}".removesuffix(" 1").replace(
        "-", "−"
    )


def _split(name: str) -> tuple[str, str]:
    """Return a name without the unit at its end, and this unit, "1" if there is
    none.
    """
    found = (
        (name.removesuffix(end), unit)
        for end, unit in SUFFIXES.items()
        if name.endswith(end)
    )
    return next(found, (name, "1"))
