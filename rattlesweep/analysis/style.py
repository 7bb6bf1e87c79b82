"""How every picture looks: colours and shapes that all can tell apart, symbols, units, files."""

import io
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

# Okabe and Ito's colours, which the colour-blind can tell apart.
BLUE, VERMILION, GREEN = "#0072B2", "#D55E00", "#009E73"
PURPLE, ORANGE, SKY, YELLOW = "#CC79A7", "#E69F00", "#56B4E9", "#F0E442"
BLACK, INK, GREY, FAINT = "#000000", "#222222", "#555555", "#e4e4e4"
FAILED, MISSING, NO_REVERSAL = BLACK, "#FFFFFF", "#C4C4C4"


class Mark(NamedTuple):
    """How a type of run is drawn: it has a shape and a hatch besides its colour."""

    colour: str
    marker: str
    hatch: str
    label: str


TYPE_STYLE = {
    "R": Mark(BLUE, "o", "", "R: reverses"),
    "SW": Mark(ORANGE, "s", "////", "SW: wobbles"),
    "unclassified": Mark(YELLOW, "x", "....", "unclassified"),
    "SS": Mark(GREEN, "^", "\\\\\\\\", "SS: steady spinning"),
    "D": Mark(PURPLE, "v", "xxxx", "D: dies"),
}
SERIES = ((BLUE, "o"), (VERMILION, "s"), (GREEN, "^"), (PURPLE, "D"), (ORANGE, "v"), (SKY, "P"),
          (BLACK, "X"), ("#8A8A8A", "*"))  # fmt: skip
THEORY: dict[str, Any] = {"color": INK, "linestyle": (0, (4, 2)), "linewidth": 1.1}

# Units as formulas.
UNITS = {
    "1": "", "sqrt(a/g)": r"$\sqrt{a/g}$", "sqrt(g/a)": r"$\sqrt{g/a}$", "deg": "degrees",
    "a": "$a$", "M g a": "$M g a$", "M g": "$M g$", "M a^2 sqrt(g/a)": r"$M a^2 \sqrt{g/a}$",
}  # fmt: skip
# Symbols of names that are not spelled by letter and index.
SYMBOLS = {
    "phi": r"$\varphi$", "n_i_rpm": "$n_i$", "t_r_s": "$t_r$",
    "xi_deg": r"$\xi$", "minus_xi_deg": r"$-\xi$", "rolling": "$l$",
    "t_rgh": "$t_{rGH}$", "ratio": r"$t_r/t_{rGH}$", "t": "time", "n": "spin $n$",
    "n_turns": "number of turns", "reversals_sure": "number of sure turns",
}  # fmt: skip
LETTERS = r"(alpha|beta|gamma|theta|xi|sigma|omega|[A-Za-z])(?:_(\w{1,3}))?"

RC: dict[str, Any] = {
    "font.size": 9, "axes.linewidth": 0.6, "axes.axisbelow": True,
    "axes.formatter.useoffset": False, "xtick.major.width": 0.6, "ytick.major.width": 0.6,
    "legend.frameon": False, "hatch.linewidth": 0.5, "hatch.color": "#00000066",
    "svg.fonttype": "path", "svg.hashsalt": "rattlesweep", "pdf.fonttype": 42,
}  # fmt: skip
# Formats of figures, with the metadata that would change from one writing to the next.
FORMATS = {"svg": {"Date": None}, "png": {"Software": None}, "pdf": {"CreationDate": None}}

# Stretches of a curve, about a pixel each; inches of an axis on which few numbers have room; with
# more oscillations than the last a curve would be a slab of ink, and its envelope is drawn.
BINS, NARROW, MOST_PERIODS = 1000, 1.1, 60


@contextmanager
def styled(style: Path | None = None) -> Iterator[None]:
    """Use Matplotlib's settings for our pictures, with those of a style file on top."""
    settings = mpl.RcParams(RC)
    try:
        if style is not None:
            settings |= mpl.rc_params_from_file(str(style), True, False)
    except (OSError, ValueError) as error:
        raise ConfigError(f"--style {style}: {one_line(str(error), 300)}") from None
    with mpl.rc_context():
        mpl.rcdefaults()
        mpl.rcParams.update(settings)
        yield


def new_figure(width: float, height: float) -> Figure:
    """Return a figure of a size in inches, made without pyplot: no window, no global state."""
    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def add_legend(figure: Figure, handles: list[Any], heading: Sequence[str] = ()) -> None:
    """Put heading lines and a legend above all panels."""
    wide = figure.get_figwidth() >= 8
    legend = figure.legend(handles=handles, loc="outside upper center", ncols=6 if wide else 4,
                           title="\n".join(heading) or None, columnspacing=1.4)  # fmt: skip
    legend.get_title().set_multialignment("center")


def add_caption(figure: Figure, words: str, *, grow: bool = True) -> None:
    """Write sentences below all panels, of a figure that grows by their height if `grow`."""
    size = 7.0
    lines = textwrap.wrap(words.replace("$", "\\$"), int(1.9 * 72 * figure.get_figwidth() / size))
    figure.supxlabel("\n".join(lines), fontsize=size, color=GREY, multialignment="left")
    if grow:
        figure.set_figheight(figure.get_figheight() + 0.02 * size * len(lines))


def light_grid(axes: Any) -> None:
    """Draw faint lines behind the data, and no frame above and on the right."""
    axes.grid(visible=True, color=FAINT, linewidth=0.6)
    axes.spines[["top", "right"]].set_visible(False)


def entry(words: str, **look: Any) -> Line2D:
    """Make an entry of a legend."""
    return Line2D([], [], label=words, **{"linestyle": "", **look})


def scale_axis(axes: Any, which: str, values: Any, log: bool, name: str = "t_r") -> None:
    """Make an axis for values of some name logarithmic if `log`."""
    if log:
        if np.min(values) <= 0:
            raise ConfigError(f"--log: {name} has values that are not positive; leave it out")
        getattr(axes, f"set_{which}scale")("log")
        plain_ticks(axes, which, float(np.min(values)), float(np.max(values)))


def plain_ticks(axes: Any, which: str, low: float, high: float) -> None:
    """Set ticks of a logarithmic axis in plain numbers, enough of them over half a decade too."""
    axis = getattr(axes, f"{which}axis")
    span = high / low if low > 0 else 1.0
    subs = (1.0, 2.0, 5.0) if span < 40 else (1.0, 3.0) if span < 300 else (1.0,)
    if which == "x" and axes.get_position().width * axes.figure.get_figwidth() < NARROW:
        subs = (1.0,) if span > 10 else (1.0, 3.0)
    axis.set_major_locator(MaxNLocator(4) if span < 4 else LogLocator(subs=subs, numticks=20))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())


def thin(values: Floats, bins: int) -> Places:
    """Return the places of the ends, and of the least and largest value in each of some bins."""
    places = np.arange(len(values))
    if len(values) <= 2 * bins:
        return places
    extremes = [part[[values[part].argmin(), values[part].argmax()]]
                for part in np.array_split(places, bins)]  # fmt: skip
    return np.union1d(extremes, places[[0, -1]])


def curve(axis: Any, t: Floats, values: Floats, colour: str = BLUE, **look: Any) -> None:
    """Draw a curve; one of very many oscillations by its extremes in stretches of one or more."""
    look = {"color": colour, "linewidth": 0.8} | look
    periods = np.count_nonzero(np.diff(np.sign(np.diff(values)))) / 2
    if periods <= MOST_PERIODS or not np.isfinite(values).all():
        places = thin(values, BINS)
        axis.plot(t[places], values[places], **look)
        return
    starts = np.linspace(0, len(t), int(min(BINS, periods / 1.5)) + 1).astype(np.int64)[:-1]
    low, high = np.minimum.reduceat(values, starts), np.maximum.reduceat(values, starts)
    middle = t[(starts + np.append(starts[1:], len(t)) - 1) // 2]
    middle[0], middle[-1] = t[0], t[-1]
    axis.fill_between(middle, low, high, color=colour, alpha=0.25, linewidth=0)
    for edge in (low, high):
        axis.plot(middle, edge, **look)
        look.pop("label", None)


def encode(figure: Figure, kind: str, dpi: float) -> bytes:
    """Return the bytes of a figure as one of `FORMATS`; equal figures give equal bytes."""
    buffer = io.BytesIO()
    try:
        figure.savefig(buffer, format=kind, dpi=dpi, metadata=FORMATS[kind])
    except ValueError as error:  # a title may be no formula
        raise ConfigError(f"a text in the picture: {' '.join(str(error).split())}") from None
    return buffer.getvalue()


def save(figure: Figure, paths: Sequence[Path], dpi: float) -> None:
    """Write a figure to some files, each in one step, in the formats of their endings."""
    for path in paths:
        kind = path.suffix.lower().removeprefix(".")
        if kind not in FORMATS:
            raise ConfigError(f"path {path}: the name must end in .{', .'.join(FORMATS)}")
        replace_file(path, encode(figure, kind, dpi))


def save_table(rows: pd.DataFrame, path: Path) -> None:
    """Write a table as CSV or Parquet, by the ending, in one step."""
    csv = path.suffix.lower() == ".csv"
    replace_file(path, rows.to_csv(index=False).encode() if csv else rows.to_parquet(index=False))


def text_table(rows: Sequence[Mapping[Any, Any]], form: str = ".6g") -> str:
    """Lay rows out for a terminal under their keys, without keys that none has."""
    frame = pd.DataFrame(rows).dropna(axis=1, how="all").astype(object)
    frame = frame.where(frame.notna(), "-")
    return frame.to_string(index=False, float_format=lambda x: f"{x:{form}}")


def symbol(name: str) -> str:
    """Return the symbol of a quantity: of a name such as ``omega_p`` a letter with its index."""
    if name in SYMBOLS or not (found := re.fullmatch(LETTERS, name)):
        return SYMBOLS.get(name, name)
    letter = f"\\{found[1]}" if len(found[1]) > 1 else found[1]
    return f"${letter}_{{{found[2]}}}$" if found[2] else f"${letter}$"


def label(name: str, unit: str | None = None) -> str:
    """Return the symbol of a quantity with its unit in brackets, by default as columns have it."""
    if unit is None:
        known = {column.name: column for part in (*RUNS.values(), MEASURED) for column in part}
        degrees = "deg" if name.endswith("_deg") else "1"
        unit = known[name].metadata[b"unit"].decode() if name in known else degrees
    shown = UNITS.get(unit, unit)
    return f"{symbol(name)} ({shown})" if shown else symbol(name)


def value_text(name: str, value: float) -> str:
    """Return a text such as ``n_i = -0.1``."""
    return f"{symbol(name)} = {value:.4g}".replace("-", "−")
