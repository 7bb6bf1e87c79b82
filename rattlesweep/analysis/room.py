"""The room of a figure: sizes that the user chose, and texts that fit into them."""

import itertools
import math
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.legend import Legend
from matplotlib.text import Text
from matplotlib.ticker import MaxNLocator
from matplotlib.transforms import Bbox

from rattlesweep.analysis.style import (
    LEAST_SIZE,
    RC,
    PlainTicks,
    Style,
    local_numbers,
    new_figure,
    styled,
    valid_texts,
)
from rattlesweep.words.errors import ConfigError

LEAST_PANEL = 0.3  # inches, of the height of a panel
# Heights that are tried for a figure without room, over the one that was asked for.
HIGHER = (1.2, 1.4, 1.7, 2.0, 2.5, 3.0)


def usual_figure(width: float, height: float) -> Figure:
    """Return a figure of the size that the caller has chosen, else of a usual one."""
    return new_figure(*(chosen_size() or (width, height)))


@contextmanager
def drawn_as(
    size: tuple[float, float] | None = None, style: Style = None
) -> Iterator[None]:
    """Draw figures in a size and a style of the user, with the user's decimal sign."""
    with styled(style):
        if size is not None:
            mpl.rcParams["figure.figsize"] = size
        with local_numbers(), sized(size):
            yield


def separate_ticks(figure: Figure) -> None:
    """Take fewer ticks along the abscissas until their labels stand apart.

    Where two labels are still too long, they stand upright.
    """
    fit_texts(figure)
    for turn in range(8):
        # The layout is solved first, on which the places of the labels depend.
        if turn:
            with valid_texts():
                figure.draw_without_rendering()
        if not _crowded(figure):
            return
        for axes in figure.axes:
            locator = axes.xaxis.get_major_locator()
            if isinstance(locator, PlainTicks):
                locator.most = max(2, locator.shown - 1)
            elif isinstance(locator, MaxNLocator):
                shown = len(_labels(axes))
                axes.xaxis.set_major_locator(MaxNLocator(max(2, shown - 2)))
    for axes in figure.axes:
        axes.tick_params(axis="x", labelrotation=90)


def _labels(axes: Axes) -> list[Bbox]:
    """Return the places of the labels at the ticks of an abscissa."""
    low, high = sorted(axes.get_xlim())
    boxes: list[Bbox] = []
    for tick in axes.xaxis.get_major_ticks():
        text = tick.label1
        if tick.get_loc() < low or tick.get_loc() > high or not text.get_visible():
            continue
        if text.get_text():
            boxes.append(text.get_window_extent())
    return boxes


def _crowded(figure: Figure) -> bool:
    """Return whether labels of neighbouring ticks, of any panels, touch."""
    boxes = [box for axes in figure.axes for box in _labels(axes)]
    gap = 0.6 * float(mpl.rcParams["font.size"]) * figure.dpi / 72
    for box, other in itertools.combinations(boxes, 2):
        apart = max(box.x0, other.x0) - min(box.x1, other.x1)
        same_line = min(box.y1, other.y1) > max(box.y0, other.y0)
        if same_line and apart < gap:
            return True
    return False


def chosen_size() -> tuple[float, float] | None:
    """Return the size of a figure that the caller's settings or a style have chosen."""
    size = tuple(mpl.rcParams["figure.figsize"])
    if size == tuple(mpl.rcParamsDefault["figure.figsize"]):
        return None
    width, height = size
    return float(width), float(height)


@contextmanager
def sized(size: tuple[float, float] | None) -> Iterator[None]:
    """Draw a narrow figure with smaller letters, unless the caller has chosen theirs.

    Raise a ConfigError if its panels have no room.
    """
    settings: dict[Any, Any] = {}
    if size is not None and mpl.rcParams["font.size"] == RC["font.size"]:
        settings["font.size"] = min(9.0, max(7.0, 5.2 + 0.54 * size[0]))
    with mpl.rc_context(settings), warnings.catch_warnings():
        if size is not None:
            warnings.filterwarnings("error", "constrained_layout not applied")
        try:
            yield
        except UserWarning:
            assert size is not None
            raise NoRoomError(size) from None


class NoRoomError(ConfigError):
    """A figure of this size has no room for its panels; another `height` may do.

    One that `is_narrow` needs more width.
    """

    def __init__(
        self,
        size: tuple[float, float],
        height: float | None = None,
        is_narrow: bool = False,
    ) -> None:
        self.is_narrow = is_narrow
        more = "more width" if is_narrow else "more"
        if height is not None:
            more = f"{size[0]:g},{height:g}"
        super().__init__(
            "size: the panels, their legend and their caption do not fit into "
            f"{size[0]:g} x {size[1]:g} inches; give {more}, select fewer values, or "
            "leave the caption out"
        )


def with_room(
    draw: Callable[[tuple[float, float]], Figure], size: tuple[float, float]
) -> Figure:
    """Return the figure of a size; where it has no room, name a height that has."""
    try:
        return draw(size)
    except NoRoomError as error:
        if error.is_narrow:
            raise
        raise NoRoomError(size, _height_with_room(draw, size)) from None


def _height_with_room(
    draw: Callable[[tuple[float, float]], Figure], size: tuple[float, float]
) -> float | None:
    width, height = size
    for factor in HIGHER:
        enough = math.ceil(10 * factor * height) / 10
        with suppress(NoRoomError):
            draw((width, enough))
            return enough
    return None


def misplaced_texts(figure: Figure) -> list[str]:
    """Return headings and entries of legends that leave the figure, and headings of
    panels that touch each other.
    """
    with valid_texts():
        figure.draw_without_rendering()
    titles = [
        title
        for axes in figure.axes
        for place in ("left", "center", "right")
        if (title := _title_at(axes, place)).get_text()
    ]
    entries = [text for legend in figure.findobj(Legend) for text in legend.get_texts()]
    left, right = figure.bbox.intervalx
    wrong = []
    for text in (*titles, *entries):
        box = text.get_window_extent()
        if box.x0 < left or box.x1 > right:
            wrong.append(text.get_text())
    for title, other in itertools.combinations(titles, 2):
        if title.get_window_extent().overlaps(other.get_window_extent()):
            wrong.append(title.get_text())
    return wrong


def check_panels(figure: Figure, size: tuple[float, float]) -> None:
    """Raise a ConfigError if a figure of this size has a panel that is too low to read,
    or texts that touch or are cut.
    """
    if misplaced_texts(figure):
        raise NoRoomError(size, is_narrow=True)
    for axes in figure.axes:
        height = axes.get_window_extent().height / figure.dpi
        if axes.axison and height < LEAST_PANEL:
            raise NoRoomError(size)


def fit_texts(figure: Figure) -> None:
    """Make labels and headings smaller that are longer than their panels.

    None gets below `LEAST_SIZE`.  An ordinate's label that is still too long stays in
    the middle row of panels only, and an abscissa's in the middle column.
    """
    # The layout is solved first, on which the lengths depend.
    with valid_texts():
        figure.draw_without_rendering()
    shrunk = False
    for axes in figure.axes:
        room = axes.get_window_extent()
        shrunk |= _join_titles(axes) or _stack_titles(axes)
        across = (axes.xaxis.label, axes.title)
        for text, which in (
            *((each, "width") for each in across),
            (axes.yaxis.label, "height"),
        ):
            shrunk |= _shrink(text, getattr(room, which), which)
        shrunk |= _break_title(axes.title, room.width)
    if not shrunk:
        return
    with valid_texts():
        figure.draw_without_rendering()
    _keep_middle(figure, "yaxis", "height")
    _keep_middle(figure, "xaxis", "width")


def fit_to_size(figure: Figure) -> None:
    """Fit the texts of a figure whose size the caller has chosen.

    Raise a ConfigError if its panels or texts have no room.
    """
    size = chosen_size()
    if size is None:
        return
    fit_texts(figure)
    with valid_texts():
        figure.draw_without_rendering()
    check_panels(figure, size)


def _title_at(axes: Axes, place: str) -> Text:
    """Return the title at the left, the center or the right of a panel."""
    name = {"left": "_left_title", "center": "title", "right": "_right_title"}[place]
    return getattr(axes, name)


def _join_titles(axes: Axes) -> bool:
    """Make one title of a letter at the left and a title that it would touch."""
    letter = _title_at(axes, "left")
    if not (letter.get_text() and axes.title.get_text()):
        return False
    if not letter.get_window_extent().overlaps(axes.title.get_window_extent()):
        return False
    axes.title.set_text(f"{letter.get_text()} {axes.title.get_text()}")
    letter.set_text("")
    return True


def _stack_titles(axes: Axes) -> bool:
    """Put a title at the right below one at the left that it would touch."""
    left, right = _title_at(axes, "left"), _title_at(axes, "right")
    if not (left.get_text() and right.get_text()):
        return False
    if not left.get_window_extent().overlaps(right.get_window_extent()):
        return False
    axes.title.update_from(right)
    axes.title.set_text(f"{left.get_text()}\n{right.get_text()}")
    axes.title.set_horizontalalignment("center")
    left.set_text("")
    right.set_text("")
    return True


def _break_title(title: Text, room: float) -> bool:
    """Break a title at its commas, from the first on, until each line has room."""
    broken = False
    while title.get_window_extent().width > room and ", " in title.get_text():
        title.set_text(title.get_text().replace(", ", ",\n", 1))
        broken = True
    return broken


def _shrink(text: Text, room: float, which: str) -> bool:
    """Make a text smaller that is longer than its room; return whether it was."""
    if not text.get_text():
        return False
    length = getattr(text.get_window_extent(), which)
    size = float(text.get_fontsize())
    if length <= room or size <= LEAST_SIZE:
        return False
    text.set_fontsize(max(LEAST_SIZE, size * room / length))
    return True


def _keep_middle(figure: Figure, axis: str, which: str) -> None:
    """Clear all but the middle one of equal labels that would touch each other."""
    labels = []
    for axes in figure.axes:
        text = getattr(axes, axis).label
        if text.get_text() and not hasattr(axes, "_colorbar"):
            length = getattr(text.get_window_extent(), which)
            labels.append(
                (text, length > 1.08 * getattr(axes.get_window_extent(), which))
            )
    words = {text.get_text() for text, _ in labels}
    if len(words) == 1 and any(too_long for _, too_long in labels):
        for place, (text, _) in enumerate(labels):
            if place != len(labels) // 2:
                text.set_text("")
