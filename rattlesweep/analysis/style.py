"""The look of every picture: colours, marks, labels, legends, and files."""

import io
import locale
import math
import shutil
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

import matplotlib as mpl
import numpy as np
import pandas as pd
from matplotlib import font_manager
from matplotlib import style as mpl_styles
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_hex
from matplotlib.figure import Figure, SubFigure
from matplotlib.lines import Line2D
from matplotlib.text import Text
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullFormatter
from numpy.typing import ArrayLike

from rattlesweep.arrays import Floats, Places
from rattlesweep.rows.columns import define
from rattlesweep.system.files import replace_file
from rattlesweep.words.defaults import FIGURE_DPI
from rattlesweep.words.errors import ConfigError, one_line, printable
from rattlesweep.words.units import readable_unit

# The palette of Okabe and Ito, which colour-blind readers can tell apart.
BLUE = "#0072B2"
VERMILION = "#D55E00"
GREEN = "#009E73"
PURPLE = "#CC79A7"
ORANGE = "#E69F00"
SKY = "#56B4E9"
YELLOW = "#F0E442"
WINE = "#882255"
BLACK = "#000000"
INK = "#222222"
GREY = "#555555"
SILVER = "#A6A6A6"
FAINT = "#e4e4e4"
# Cells of a map without a type or a value.
FAILED_COLOUR = BLACK
MISSING_COLOUR = "#FFFFFF"
NO_REVERSAL = "#F3D9D2"


class LabelLook(NamedTuple):
    """The look of a type or a regime; marker and hatch identify it without colour."""

    colour: str
    marker: str
    hatch: str
    label: str


TYPE_STYLE = {
    "R": LabelLook(BLUE, "o", "", "R: reverses"),
    "SW": LabelLook(ORANGE, "s", "////", "SW: wobbles"),
    "unclassified": LabelLook(SILVER, "x", "....", "unclassified"),
    "SS": LabelLook(GREEN, "^", "\\\\\\\\", "SS: steady spinning"),
    "D": LabelLook(PURPLE, "v", "xxxx", "D: dies"),
}
# A colour that types have, too, has the same meaning.
REGIME_STYLE = {
    "steady": LabelLook(GREEN, "^", "", "steady"),
    "periodic": LabelLook(SKY, "o", "", "periodic"),
    "quasi-periodic": LabelLook(YELLOW, "s", "", "quasi-periodic"),
    "attractor": LabelLook(VERMILION, "D", "", "strange attractor"),
    "conservative": LabelLook(WINE, "v", "", "chaos of conservative kind"),
    "undecided": LabelLook(SILVER, "x", "", "undecided: run too short"),
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
# Entries of legends for what theory says.
OF_THEORY = "theory"
STABLE = "stable by Bondi's threshold"
BONDI = "Bondi's threshold"
THEORY: dict[str, Any] = {"color": INK, "linestyle": (0, (4, 2)), "linewidth": 1.1}

# Units of columns as formulas.
UNITS = {
    "1": "",
    "sqrt(a/g)": r"$\sqrt{a/g}$",
    "sqrt(g/a)": r"$\sqrt{g/a}$",
    "sqrt(g a)": r"$\sqrt{g\,a}$",
    "deg": "degrees",
    "a": "$a$",
    "M g a": r"$M\,g\,a$",
    "M g": r"$M\,g$",
    "M a^2 sqrt(g/a)": r"$M\,a^2 \sqrt{g/a}$",
    "M sqrt(g/a)": r"$M \sqrt{g/a}$",
}
RC: dict[str, object] = {
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
_FORMATS = {
    "svg": {"Date": None},
    "png": {"Software": None},
    "pdf": {"CreationDate": None},
}

# A range below this part of a curve's own is rounding.
_ROUNDING = 1e-9
_BINS = 1000  # columns of a curve, each about a pixel wide
# Columns whose extremes make one point of an envelope: the fewest that hold a period.
_WIDTHS = (1, 3, 5, 9)
# Windows hold a period if nearly all ranges in them are at least this part of that in
# twice as many columns, and this part of the mean of their neighbours.
_WHOLE = 0.75
_EVEN = 0.99
_EXCEPT = 0.05  # of the windows
# A sentence for the caption of a figure that has one.
BAND = (
    "Bands are oscillations too fast for the figure; their edges are the largest and "
    "the smallest values."
)
LEAST_SIZE = 6.0  # points, of any text
CAPTION_SIZE = 7.0  # points; less where the text of the figure is small
LEGEND_PART = 0.96  # of the width of a figure, at most
CAPTION_PART = 0.22  # of the height of a figure that does not grow
LETTERS_A_LINE = 1.75  # in a line as wide as a letter is high
# A style file, the name of a style, or settings.
Style: TypeAlias = "Path | str | Mapping[str, Any] | None"


@contextmanager
def local_numbers() -> Iterator[None]:
    """Use the decimal sign of the user's locale, as a program that asks for it does.

    Nothing changes unless the settings have ``axes.formatter.use_locale``, or where the
    system lacks the locale.  It is for commands: in Python, the program has its locale.
    """
    before = locale.setlocale(locale.LC_NUMERIC)
    if mpl.rcParams["axes.formatter.use_locale"]:
        with suppress(locale.Error):
            locale.setlocale(locale.LC_NUMERIC, "")
    try:
        yield
    finally:
        locale.setlocale(locale.LC_NUMERIC, before)


@contextmanager
def styled(style: Style = None) -> Iterator[None]:
    """Draw with the settings of all pictures, overridden by the caller's.

    These are the ``matplotlib.rcParams`` that differ from Matplotlib's own, as in an
    ``rc_context``, and then those of a style: a file, a name of Matplotlib's, or a
    mapping.
    """
    settings: dict[Any, Any] = dict(RC)
    defaults = mpl.rcParamsDefault
    for key, value in mpl.rcParams.items():
        if not key.startswith("backend") and value != defaults[key]:
            settings[key] = value
    # What would be in the way of every picture is left out.
    settings.pop("savefig.format", None)
    if not (shutil.which("latex") and shutil.which("dvipng")):
        settings.pop("text.usetex", None)
    if settings.get("image.cmap") not in mpl.colormaps:
        settings.pop("image.cmap", None)
    settings |= _settings_of(style)
    if settings.get("image.cmap", "viridis") not in mpl.colormaps:
        problem = f"image.cmap: there is no map {settings['image.cmap']}"
        raise ConfigError(f"--style {style}: {one_line(problem)}")
    with mpl.rc_context():
        mpl.rcdefaults()
        mpl.rcParams.update(settings)
        if "mathtext.fontset" not in settings:
            mpl.rcParams["mathtext.fontset"] = _font_of_formulas()
        yield


def _font_of_formulas() -> str:
    """Return the font set of formulas that goes with the font of the text."""
    file = font_manager.findfont(font_manager.FontProperties())
    name = font_manager.get_font(file).family_name
    if name in ("DejaVu Sans", "DejaVu Serif"):
        return name.replace(" ", "").lower()
    if name.startswith(("cmr", "CMU", "Computer Modern", "Latin Modern")):
        return "cm"
    is_sans = "Sans" in name or name in mpl.rcParams["font.sans-serif"]
    return "stixsans" if is_sans else "stix"


def _settings_of(style: Style) -> dict[Any, Any]:
    """Return the settings of a style; raise a ConfigError if there is none."""
    if style is None:
        return {}
    try:
        if isinstance(style, Mapping):
            return dict(mpl.RcParams(style))
        if str(style) in mpl_styles.library:
            return dict(mpl_styles.library[str(style)])
        return dict(mpl.rc_params_from_file(str(style), True, False))
    except OSError as error:
        raise ConfigError(
            f"--style {style}: {error.strerror}; give the path of a style file, or the "
            "name of a style, of Matplotlib"
        ) from None
    except (KeyError, ValueError) as error:
        raise ConfigError(f"--style {style}: {one_line(str(error), 300)}") from None


def new_figure(width: float, height: float) -> Figure:
    """Return a figure of a size in inches, which has no window or global state."""
    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def add_legend(
    figure: Figure | SubFigure, handles: Sequence[Artist], heading: Sequence[str] = ()
) -> None:
    """Put a heading and a legend above all panels, in as few rows as fit."""
    count = max(1, len(handles))
    for rows in range(1, count + 1):
        legend = figure.legend(
            handles=handles,
            loc="outside upper center",
            columnspacing=1.4,
            handlelength=1.6,
            ncols=math.ceil(count / rows),
        )
        # Letters of another resolution may be a little wider.
        room = LEGEND_PART * figure.bbox.width
        if rows == count or legend.get_window_extent().width <= room:
            break
        legend.remove()
    title = legend.get_title()
    width = figure.bbox.width / figure.dpi
    size = float(title.get_fontsize())
    lines = [_wrapped(str(line), width, size) for line in heading]
    legend.set_title("\n".join(lines))
    title.set_multialignment("center")


def _wrapped(text: str, width: float, size: float) -> str:
    """Break lines of a text that are longer than a width in inches, at a letter size.

    A line with a formula stays as it is.
    """
    letters = int(LETTERS_A_LINE * 72 * width / size)
    return "\n".join(
        line if "$" in line else textwrap.fill(line, letters)
        for line in text.split("\n")
    )


def add_caption(figure: Figure, sentences: Sequence[str], *, grow: bool = True) -> None:
    """Write sentences below all panels; with `grow`, the figure gets higher by them.

    Otherwise only as many sentences are written as leave the panels their room.
    """
    size = min(CAPTION_SIZE, 0.85 * float(mpl.rcParams["font.size"]))
    size = max(size, LEAST_SIZE)
    letters = int(LETTERS_A_LINE * 72 * figure.get_figwidth() / size)
    line_height = 0.02 * size  # inches
    room = math.inf if grow else CAPTION_PART * figure.get_figheight()
    lines: list[str] = []
    for count in range(len(sentences), 0, -1):
        words = " ".join(sentences[:count])
        lines = textwrap.wrap(words.replace("$", "\\$"), letters)
        if line_height * len(lines) <= room:
            break
        lines = []
    figure.supxlabel("\n".join(lines), fontsize=size, color=GREY, multialignment="left")
    if grow:
        figure.set_figheight(figure.get_figheight() + line_height * len(lines))


def small_size() -> float:
    """Return the size of small letters, in points."""
    return max(LEAST_SIZE, 0.7 * float(mpl.rcParams["font.size"]))


def light_grid(axes: Axes) -> None:
    """Draw a faint grid behind the data, and no frame on the top and the right."""
    axes.grid(visible=True, color=FAINT, linewidth=0.6)
    axes.spines[["top", "right"]].set_visible(False)


def entry(words: str, **look: Any) -> Line2D:
    """Return a legend entry."""
    return Line2D([], [], label=words, **{"linestyle": "", **look})


def scale_axis(
    axes: Axes, which: str, values: ArrayLike, log: bool, name: str = "t_r"
) -> None:
    """Make an axis logarithmic if `log`; messages call its values `name`."""
    if not log:
        return
    low = float(np.min(values))
    if low <= 0:
        raise ConfigError(
            f"--log: {name} has values that are not positive; leave it out"
        )
    getattr(axes, f"set_{which}scale")("log")
    plain_ticks(axes, which, low, float(np.max(values)))


def colour_of(place: int, count: int) -> str:
    """Return the colour of a value by its place among all `count` values of a sweep."""
    if count <= len(SERIES):
        return SERIES[place][0]
    # More values than colours that can be told apart: from dark to light.
    return to_hex(mpl.colormaps["viridis"](0.92 * place / (count - 1)))


class PlainTicks(LogLocator):
    """Ticks at multiples of the powers of ten, as many as there is room for."""

    most = 100  # ticks that have room, beside Matplotlib's own estimate
    shown = 0  # ticks between the ends

    def tick_values(self, vmin: float, vmax: float) -> Any:
        """Return the ticks between two ends."""
        axis: Any = self.axis  # set by Matplotlib
        most = min(self.most, axis.get_tick_space())
        best: tuple[float, ...] = (1.0,)
        self.shown = 0
        for subs in (
            (1.0, 2.0, 5.0),
            (1.0, 3.0),
            (1.0, 1.5, 2.0, 3.0, 5.0, 7.0),
            (1.0,),
        ):
            shown = self._count(subs, vmin, vmax)
            if self.shown < shown <= most:
                best = subs
                self.shown = shown
            if 3 <= shown <= most:
                break
        self.set_params(subs=best)
        return super().tick_values(vmin, vmax)

    def _count(self, subs: tuple[float, ...], low: float, high: float) -> int:
        """Return the number of ticks at these multiples between two ends."""
        self.set_params(subs=subs)
        ticks = np.asarray(super().tick_values(low, high))
        return int(np.count_nonzero((ticks >= low) & (ticks <= high)))


def plain_ticks(axes: Axes, which: str, low: float, high: float) -> None:
    """Label a logarithmic axis with plain numbers instead of powers of ten."""
    axis = getattr(axes, f"{which}axis")
    if high > 4 * low:
        axis.set_major_locator(PlainTicks())
    else:
        axis.set_major_locator(MaxNLocator(4))
    axis.set_major_formatter(FuncFormatter(lambda value, _: number_text(value, "g")))
    axis.set_minor_formatter(NullFormatter())


def thin(values: Floats, bins: int) -> Places:
    """Return the places of both ends and of the extremes of `bins` stretches."""
    places = np.arange(len(values))
    if len(values) <= 2 * bins:
        return places
    extremes = []
    for stretch in np.array_split(places, bins):
        extremes.append(stretch[values[stretch].argmin()])
        extremes.append(stretch[values[stretch].argmax()])
    return np.union1d(extremes, places[[0, -1]])


def curve(
    axis: Axes, t: Floats, values: Floats, colour: str = BLUE, **look: Any
) -> bool:
    """Draw a curve, or as a band the column_envelope of very many oscillations.

    Return whether it is a band, which `BAND` explains.
    """
    lines: dict[str, Any] = {"color": colour, "linewidth": 0.8} | look
    band = None
    if np.isfinite(values).all():
        band = column_envelope(t, values)
    if band is None:
        places = thin(values, _BINS)
        axis.plot(t[places], values[places], **lines)
        return False
    axis.fill_between(*band, color=colour, alpha=0.25, linewidth=0)
    axis.plot(band.t, band.low, **lines)
    lines.pop("label", None)  # one entry in the legend is enough
    axis.plot(band.t, band.high, **lines)
    return True


class Envelope(NamedTuple):
    """The lowest and the highest value of a curve around times."""

    t: Floats
    low: Floats
    high: Floats


def column_envelope(t: Floats, values: Floats) -> Envelope | None:
    """Return the extremes of a curve in each column of a picture.

    None is returned for a curve whose single oscillations can be seen.  No period is
    counted: a wobble has several, and its slope has more extremes than it has periods.
    """
    # Imported here, as most commands draw nothing and start faster without it.
    from scipy.ndimage import maximum_filter1d, minimum_filter1d

    edges = np.linspace(t[0], t[-1], _BINS + 1)[:-1]
    # A column without rows, as between long steps, is left out.
    starts = np.unique(np.searchsorted(t, edges))
    if len(values) <= 2 * len(starts):
        return None
    low = np.minimum.reduceat(values, starts)
    high = np.maximum.reduceat(values, starts)
    ends = np.append(starts[1:], len(t)) - 1
    middle = (t[starts] + t[ends]) / 2
    middle[[0, -1]] = t[[0, -1]]
    for width in _WIDTHS:
        lowest = minimum_filter1d(low, width)
        highest = maximum_filter1d(high, width)
        ranges = highest - lowest
        doubled = maximum_filter1d(high, 2 * width) - minimum_filter1d(low, 2 * width)
        moves = doubled[1:-1] > _ROUNDING * np.ptp(values)
        if not moves.any():
            return None
        inner = ranges[1:-1][moves]
        is_whole = inner >= _WHOLE * doubled[1:-1][moves]
        # An even growth has neighbours whose geometric mean is the range between.
        mean = np.sqrt(ranges[:-2] * ranges[2:])[moves]
        is_even = inner >= _EVEN * mean
        if np.mean(is_whole & is_even) >= 1 - _EXCEPT:
            # Windows beyond the ends are no whole ones; the next one has their columns.
            half = width // 2
            for extremes in (lowest, highest):
                extremes[:half] = extremes[half]
                extremes[len(extremes) - half :] = extremes[-half - 1]
            return Envelope(middle, lowest, highest)
    return None


def encode_figure(figure: Figure, kind: str, dpi: float = FIGURE_DPI) -> bytes:
    """Return a figure in one of `_FORMATS`; equal figures give equal bytes."""
    for text in figure.findobj(Text):
        # An SVG with a control character is no XML.
        lines = map(printable, text.get_text().split("\n"))
        shown = "\n".join(lines)
        if shown != text.get_text():
            text.set_text(shown)
    buffer = io.BytesIO()
    with valid_texts():
        figure.savefig(buffer, format=kind, dpi=dpi, metadata=_FORMATS[kind])
    return buffer.getvalue()


@contextmanager
def valid_texts() -> Iterator[None]:
    """Raise a ConfigError if Matplotlib cannot draw a formula, as in a title."""
    try:
        yield
    except RecursionError:
        raise ConfigError(
            "a text in the picture: a formula is nested too deeply"
        ) from None
    except (ValueError, RuntimeError) as error:
        reason = " ".join(str(error).split())
        if isinstance(error, ValueError):
            raise ConfigError(f"a text in the picture: {reason}") from None
        if not mpl.rcParams["text.usetex"]:
            raise
        raise ConfigError(
            f"a text in the picture: {reason}; set text.usetex to False"
        ) from None


def save_figure(figure: Figure, paths: Sequence[Path], dpi: float = FIGURE_DPI) -> None:
    """Write a figure to files atomically, in the formats of their endings."""
    for path in paths:
        kind = path.suffix.lower().removeprefix(".")
        if kind not in _FORMATS:
            raise ConfigError(
                f"path {path}: the name must end in .{', .'.join(_FORMATS)}"
            )
        replace_file(path, encode_figure(figure, kind, dpi))


def save_table(rows: pd.DataFrame, path: Path) -> None:
    """Write a table atomically, as CSV or Parquet by the ending."""
    if path.suffix.lower() == ".csv":
        content = rows.to_csv(index=False).encode()
    else:
        content = rows.to_parquet(index=False)
    replace_file(path, content)


def text_table(rows: Sequence[Mapping[Any, object]], form: str = ".6g") -> str:
    """Return rows as a table of text, without the columns that are empty."""
    frame = pd.DataFrame(rows).dropna(axis=1, how="all").astype(object)
    frame = frame.where(frame.notna(), "-").map(_cell).rename(columns=printable)
    return frame.to_string(index=False, float_format=lambda x: f"{x:{form}}")


def _cell(value: object) -> object:
    """Return a value as it is printed in a table."""
    if isinstance(value, str):
        return printable(value)
    return value


def label(name: str, unit: str | None = None) -> str:
    """Return the symbol of a quantity with its unit, by default that of its column."""
    definition = define(name)
    if unit is None:
        unit = definition.unit
    formula = UNITS.get(unit, unit)
    if not formula:
        return definition.symbol
    # A column of the user's may be called after its unit, as in shape_length_m.
    symbol = definition.symbol.removesuffix(f"_{unit}")
    return f"{symbol} ({formula})"


def number_text(value: float, form: str = ".4g") -> str:
    """Return a number with the point and the minus sign that the settings ask for."""
    text = f"{value:{form}}"
    if mpl.rcParams["axes.formatter.use_locale"]:
        text = locale.format_string(f"%{form}", value)
    if mpl.rcParams["axes.unicode_minus"]:
        text = text.replace("-", "−")
    return text


def value_text(name: str, value: float) -> str:
    """Return a text such as ``n_i = -0.1`` or ``n_i = -60 rpm``."""
    definition = define(name)
    factor, unit = readable_unit(value, definition.unit)
    text = f"{definition.symbol} = {number_text(factor * value)}"
    # The units of the body are left out.
    if unit in UNITS and unit != "deg":
        return text
    return f"{text} {unit}"


def symbol(name: str) -> str:
    """Return the symbol of a quantity or column."""
    return define(name).symbol
