"""Which kinds of pictures fit a sweep, and which one suits it."""

from collections.abc import Sequence

from rattlesweep.analysis.layout import SKEW, TARGETS, SweepLayout
from rattlesweep.analysis.plots.distribution import Distribution
from rattlesweep.analysis.plots.fractions import BinnedFractions, Fractions
from rattlesweep.analysis.plots.maps import Map, Regimes
from rattlesweep.analysis.plots.picture import MOST_PANELS, SIDE, Picture
from rattlesweep.analysis.plots.scatter import Scatter
from rattlesweep.analysis.plots.times import Times
from rattlesweep.words.errors import ConfigError

FIGURE_KINDS: dict[str, type[Picture]] = {
    "fractions": Fractions,
    "times": Times,
    "ratio": Times,
    "map": Map,
    "reversals": Map,
    "regimes": Regimes,
    "distribution": Distribution,
    "scatter": Scatter,
}

# Maps of what a word of `record` adds.
MAPS = {"regimes": "spectrum", "reversals": "reversals"}


def choose_picture(
    layout: SweepLayout,
    kind: str | None = None,
    *,
    x: str | None = None,
    quantity: str | None = None,
    colour: str | None = None,
    select: Sequence[str] = (),
    where: str | None = None,
    panels: str | None = None,
) -> Picture:
    """Return the picture of a kind, by default the one that suits the sweep."""
    layout = _selected(layout, select, where)
    if panels is not None:
        panels = layout.key(panels, f"panels {panels}")
    if kind is None:
        kind = _suitable_kind(layout, x, quantity)
    if colour is not None:
        if kind != "scatter":
            raise ConfigError(f"colour: goes with kind scatter, not {kind}")
        layout.column(colour, "colour")  # raises if there is none
    if panels is not None:
        if kind in ("distribution", "scatter"):
            raise ConfigError(
                f"panels: kind {kind} has one panel; leave panels out, or choose "
                "another kind, such as fractions or times"
            )
        if x is not None and _is_axis(layout, x) and layout.key(x, "x") == panels:
            raise ConfigError(f"panels {panels}: it is x, too; choose another one")
    if kind == "fractions" and x is not None and not _is_axis(layout, x):
        if quantity is not None:
            raise ConfigError("quantity: kind fractions counts types; leave it out")
        return BinnedFractions(layout, kind, x, quantity, panels)
    if x is not None and kind != "scatter":
        x = layout.key(x, f"x {x}")
    fitting = fitting_kinds(layout)
    if kind not in fitting:
        needs = ""
        if kind in MAPS:
            needs = f" (it needs record: [{MAPS[kind]}] and two parameters)"
        raise ConfigError(
            f"kind {kind}: does not fit this sweep{needs}; {', '.join(fitting)} fit"
        )
    if quantity is not None and kind not in ("map", "distribution", "scatter"):
        raise ConfigError(
            f"quantity: goes with kind map, distribution or scatter, not {kind}"
        )
    if kind == "reversals":
        # Only confirmed turns, where the runs have error estimates.
        quantity = "n_turns"
        if "reversals_sure" in layout.stored.schema.names:
            quantity = "reversals_sure"
    if quantity is not None:
        layout.column(quantity, "quantity")  # raises if there is none
    picture = _of_few_panels(layout, kind, x, quantity, panels)
    picture.colour = colour
    return picture


def _of_few_panels(
    layout: SweepLayout,
    kind: str,
    x: str | None,
    quantity: str | None,
    panels: str | None,
) -> Picture:
    """Return the picture, with the longest axis inside or some values left out where
    there would be too many panels.
    """
    picture = FIGURE_KINDS[kind](layout, kind, x, quantity, panels)
    if picture.count <= MOST_PANELS:
        return picture
    if x is None and panels is None and picture.inside:
        longest = max(layout.axes, key=lambda name: layout.lengths[name])
        picture = FIGURE_KINDS[kind](layout, kind, longest, quantity, panels)
        x = longest
    left_out = []
    while picture.count > MOST_PANELS:
        axis = max((*picture.rows, *picture.columns), key=lambda axis: len(axis.values))
        layout = layout.select([f"{axis.name}={float(axis.values[0])!r}"])
        left_out.append(axis.name)
        picture = FIGURE_KINDS[kind](layout, kind, x, quantity, panels)
    if left_out:
        names = " and ".join(left_out)
        picture.doubts.append(f"Only the first {names} is shown; select others.")
    return picture


def _is_axis(layout: SweepLayout, name: str) -> bool:
    """Return whether a name is that of an axis, or of no column of numbers either."""
    names = {*layout.axes, *(axis.name for axis in layout.axes.values())}
    return name in names or name not in (*layout.stored.schema.names, SKEW)


def _selected(
    layout: SweepLayout, select: Sequence[str], where: str | None
) -> SweepLayout:
    """Return the layout of selected values and runs, in SI units if there are any."""
    natural = []
    in_si = []
    for text in select:
        # A name with a unit, such as n_i_rpm, selects values in this unit, which
        # the layout has after the change to SI units.
        if text.partition("=")[0].strip() in layout.axes:
            natural.append(text)
        else:
            in_si.append(text)
    return layout.chosen(where).select(natural).in_si().select(in_si)


def _suitable_kind(layout: SweepLayout, x: str | None, quantity: str | None) -> str:
    """Return the kind that shows a column, or that suits the sweep."""
    if x in (*layout.stored.schema.names, SKEW) and x not in layout.axes:
        return "scatter"
    kind = default_kind(layout)
    if quantity is None:
        return kind
    if kind in ("map", *MAPS):
        return "map"
    return "distribution"


def fitting_kinds(layout: SweepLayout) -> list[str]:
    """Return the kinds for which parameters vary and columns are recorded."""
    kinds = []
    if layout.axes:
        if not layout.bodies and layout.stored.samples > 1:
            kinds.append("fractions")
        kinds += ["times", "ratio"]
    if len(layout.several) >= 2:
        kinds.append("map")
        kinds += [
            name for name, word in MAPS.items() if word in layout.stored.config.record
        ]
    return [*kinds, "distribution", "scatter"]


def default_kind(layout: SweepLayout) -> str:
    """Return the kind that suits a sweep, such as a map for two long axes."""
    fitting = fitting_kinds(layout)
    spin = layout.stored.config.spin
    population = "fractions" in fitting
    long_axes = sum(count >= SIDE for count in layout.lengths.values())
    if long_axes >= 2 and not population:
        return next((name for name in MAPS if name in fitting), "map")
    if not layout.several:
        return "distribution"
    if population and spin is not None and min(spin.n_i) < 0:
        return "fractions"
    if {*TARGETS} & {*layout.several}:
        return "times"
    return "ratio"
