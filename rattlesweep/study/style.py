"""How pictures look: colours and shapes that everyone can tell apart, labels, files."""

from __future__ import annotations

import io
import logging
import textwrap
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import matplotlib as mpl
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties

from rattlesweep.errors import ConfigError
from rattlesweep.study.plots.layout import Axis

# Okabe and Ito's colours. Each type has a shape and a hatch besides.
TYPE_STYLE = {
    "R": ("#0072B2", "o", "", "R: reverses"),
    "SW": ("#E69F00", "s", "////", "SW: wobbles"),
    "unclassified": ("#666666", "x", "....", "unclassified"),
    "SS": ("#009E73", "^", "\\\\\\\\", "SS: spins on"),
}
FAILED, MISSING = "#000000", "#FFFFFF"
SERIES = (("#0072B2", "o"), ("#D55E00", "s"), ("#009E73", "^"), ("#CC79A7", "D"),
          ("#E69F00", "v"), ("#56B4E9", "P"), ("#000000", "X"), ("#8A8A8A", "*"))  # fmt: skip
THEORY: dict[str, Any] = {"color": "#222222", "linestyle": (0, (4, 2)), "linewidth": 1.1}
BONDI = "#D55E00"
GREY = "#555555"

RATE, TIME = r"$\sqrt{g/a}$", r"$\sqrt{a/g}$"
SYMBOLS = {
    "K_p": ("$K_p$", ""),
    "K_r": ("$K_r$", ""),
    "n_i": ("$n_i$", RATE),
    "omega_xy0": (r"$\omega_{xy0}$", RATE),
    "alpha": (r"$\alpha$", ""),
    "beta": (r"$\beta$", ""),
    "gamma": (r"$\gamma$", ""),
    "theta": (r"$\theta$", ""),
    "phi": (r"$\varphi$", ""),
    "xi": (r"$\xi$", "rad"),
    "xi_deg": (r"$\xi$", "degrees"),
    "minus_xi_deg": (r"$-\xi$", "degrees"),
    "f_sd": ("$f_{sd}$", ""),
    "t_rgh": ("$t_{rGH}$", TIME),
    "n_0": ("$n_0$", RATE),
    "n_c1": ("$n_{c1}$", RATE),
    "omega_p": (r"$\omega_p$", RATE),
    "omega_r": (r"$\omega_r$", RATE),
}

RC: dict[str, Any] = {
    "font.size": 9,
    "axes.linewidth": 0.6,
    "axes.axisbelow": True,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "xtick.minor.width": 0.4,
    "ytick.minor.width": 0.4,
    "legend.frameon": False,
    "hatch.linewidth": 0.5,
    "hatch.color": "#00000066",
    "svg.fonttype": "path",
    "svg.hashsalt": "rattlesweep",
    "pdf.fonttype": 42,
}
# Shares of a figure that a legend may take, and type that can just be read.
WIDEST, HIGHEST, SMALLEST = 0.98, 0.35, 5.0
# Inches of an abscissa on which no more than a few numbers have room.
NARROW = 1.1
FORMATS = ("svg", "png", "pdf")


@contextmanager
def styled(style: Path | None = None) -> Iterator[None]:
    """Matplotlib's settings for our pictures, with those of a style file on top.

    Raises
    ------
    ConfigError
        The style file is not there or not one.
    """
    settings: Any = RC | ({} if style is None else dict(_read_style(style)))
    with mpl.rc_context():
        mpl.rcdefaults()
        mpl.rcParams.update(settings)
        yield


def _read_style(path: Path) -> Any:
    complaints: list[str] = []
    handler = logging.Handler()
    handler.emit = lambda record: complaints.append(record.getMessage())  # type: ignore[method-assign]
    logger = logging.getLogger("matplotlib")
    # An unknown key is only logged; here it is an error like any other.
    logger.addHandler(handler)
    propagate, logger.propagate = logger.propagate, False
    try:
        found = mpl.rc_params_from_file(str(path), fail_on_error=True, use_default_template=False)
    except FileNotFoundError:
        raise ConfigError(f"--style {path}: there is no such file") from None
    except (OSError, ValueError) as error:
        complaints.append(str(error))
    finally:
        logger.removeHandler(handler)
        logger.propagate = propagate
    if complaints:
        words = " ".join(complaints[0].split())
        raise ConfigError(f"--style {path}: it is no style file of Matplotlib: {words}")
    return found


def new_figure(width: float, height: float) -> Figure:
    """A figure of a size in inches; without pyplot: no window, nothing that outlives it."""
    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def encode(figure: Figure, kind: str, dpi: float) -> bytes:
    """Bytes of a figure as one of `FORMATS`; equal figures give equal bytes."""
    buffer = io.BytesIO()
    metadata: dict[str, Any] = {
        "svg": {"Date": None},
        "png": {"Software": None},
        "pdf": {"CreationDate": None},
    }[kind]
    figure.savefig(buffer, format=kind, dpi=dpi, metadata=metadata)
    return buffer.getvalue()


def head(figure: Figure, lines: list[str]) -> None:
    """Lines above all else: above the legend where there is one, which would lie on a title."""
    if not lines:
        return
    if not figure.legends:
        title: Any = figure.suptitle("", fontsize="medium")
    else:
        title = figure.legends[0].get_title()
        old = title.get_text()
        figure.legends[0].set_title(" ")
        lines = [*lines, *([old] if old != "None" else [])]
    # Broken where it is wider than the figure; formulas cannot be, and are made smaller.
    most = max(10, *map(len, lines))
    for width in range(most, 9, -max(1, most // 50)):
        broken = [line if "$" in line else textwrap.fill(line, width) for line in lines]
        title.set_text("\n".join(broken))
        wide = title.get_window_extent().width / figure.bbox.width
        if wide <= 0.95:
            return
    title.set_fontsize(0.95 / wide * float(title.get_fontsize()))


def formula_error(text: str) -> str | None:
    """Why Matplotlib cannot read the formulas in a text, in a few words; None if it can."""
    from matplotlib.cbook import is_math_text
    from matplotlib.mathtext import MathTextParser

    if is_math_text(text):
        try:
            MathTextParser("path").parse(text)
        except (ValueError, RuntimeError) as error:
            return str(error).strip().splitlines()[-1].strip()
    return None


def label(name: str) -> str:
    """Symbol of a quantity, with its unit."""
    symbol, unit = SYMBOLS[name]
    return f"{symbol} ({unit})" if unit else symbol


def symbol(name: str) -> str:
    """Symbol of a quantity."""
    return SYMBOLS[name][0]


def value_text(name: str, value: float) -> str:
    """Such as ``n_i = -0.1``."""
    return f"{symbol(name)} = {value:.4g}".replace("-", "−")


def legend_above(figure: Any, handles: list[Any], each: float, title: str | None = None) -> None:
    """A legend above all panels, in as many columns of a width in inches as fit.

    Smaller type makes it fit where one column is too wide, or all of it too high.
    """
    base = size = FontProperties(size=mpl.rcParams["legend.fontsize"]).get_size_in_points()
    columns = most = max(2, min(len(handles), int(figure.get_figwidth() / each)))
    while True:
        legend = figure.legend(handles=handles, loc="outside upper center", ncols=columns,
                               title=title, columnspacing=1.4, fontsize=size)  # fmt: skip
        box = legend.get_window_extent()
        wide, high = box.width / figure.bbox.width, box.height / figure.bbox.height
        if (wide <= WIDEST and high <= HIGHEST) or size <= SMALLEST:
            return
        legend.remove()
        if wide > WIDEST and columns > 1:
            columns -= 1
        else:
            size *= 0.9
            columns = min(len(handles), int(most * base / size))


def scale_axis(axes: Any, which: str, axis: Axis, log: bool | None) -> None:
    """Make an axis logarithmic if its values are, or as asked; label it."""
    wanted = axis.logarithmic if log is None else log
    if wanted and axis.values[0] <= 0:
        if log:
            raise ConfigError(f"--log: {axis.name} has values that are not positive; leave it out")
        wanted = False
    if wanted:
        getattr(axes, f"set_{which}scale")("log")
        plain_ticks(axes, which, (float(axis.values[0]), float(axis.values[-1])))


def plain_ticks(axes: Any, which: str, ends: tuple[float, float]) -> None:
    """Ticks of a logarithmic axis in plain numbers, enough of them also over half a decade."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    span = ends[1] / ends[0] if ends[0] > 0 else 1.0
    subs: tuple[float, ...] = (1.0, 1.2, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 8.0)
    for least, coarser in ((4, (1.0, 2.0, 5.0)), (8, (1.0, 3.0)), (300, (1.0,))):
        if span > least:
            subs = coarser
    if which == "x" and axes.get_position().width * axes.get_figure().get_figwidth() < NARROW:
        subs = (1.0,) if span > 8 else (1.0, 3.0)
    axis = getattr(axes, f"{which}axis")
    axis.set_major_locator(LogLocator(subs=subs, numticks=20))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())
