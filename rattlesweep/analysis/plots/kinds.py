"""Choose the right picture of an output directory."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from rattlesweep.analysis.plots.curves import Fractions, Ratio, Times
from rattlesweep.analysis.plots.layout import TARGETS, Layout
from rattlesweep.analysis.plots.map import SIDE, Map, Reversals
from rattlesweep.analysis.plots.picture import Picture
from rattlesweep.analysis.plots.runs import Distribution, Scatter
from rattlesweep.errors import ConfigError
from rattlesweep.sweeps.config.messages import not_one_of

KINDS: dict[str, Callable[[Layout, str | None, str | None], Picture]] = {
    "fractions": Fractions, "times": Times, "ratio": Ratio, "map": Map, "reversals": Reversals,
    "distribution": Distribution, "scatter": Scatter,
}  # fmt: skip


def choose_picture(
    layout: Layout,
    kind: str | None = None,
    *,
    x: str | None = None,
    quantity: str | None = None,
    select: Sequence[str] = (),
    where: str | None = None,
) -> Picture:
    """Choose the picture that suits a sweep, or take the kind that is asked for.

    Runs are read when it is first drawn, or its table asked for. Raises a ConfigError if the kind
    does not suit the sweep, or a name or a text cannot be read.
    """
    layout = layout.chosen(where).select(select)
    fitting, suited = fitting_kinds(layout), default_kind(layout)
    if kind is None and x in layout.stored.schema.names and x not in layout.axes:
        kind = "scatter"
    if x is not None and kind != "scatter":
        layout.named(x, f"--x {x}")
    if kind is None and quantity is not None:
        kind = "map" if suited in ("map", "reversals") else "distribution"
    kind = kind or suited
    if kind not in KINDS:
        raise ConfigError(f"--kind: {not_one_of(kind, fitting)}")
    if kind not in fitting:
        raise ConfigError(f"--kind {kind}: does not fit this sweep; {', '.join(fitting)} fit")
    if quantity is not None and kind not in ("map", "distribution"):
        raise ConfigError(f"--quantity: goes with --kind map or distribution, not {kind}")
    return KINDS[kind](layout, x, quantity)


def fitting_kinds(layout: Layout) -> list[str]:
    """Return the kinds for which enough varies, and is recorded."""
    plane = len(layout.several) >= 2
    fits = {
        "fractions": bool(layout.axes) and layout.population,
        "times": bool(layout.axes),
        "ratio": bool(layout.axes),
        "map": plane,
        "reversals": plane and "reversals" in layout.config.record,
    }
    return [name for name in KINDS if fits.get(name, True)]


def default_kind(layout: Layout) -> str:
    """Return the kind that suits a sweep.

    A map suits two long axes (of reversals where they are recorded), shares of types suit many
    bodies, reversal times the rest.
    """
    long = [name for name, count in layout.lengths.items() if count >= SIDE]
    if len(long) >= 2 and not layout.population:
        return "reversals" if "reversals" in layout.config.record else "map"
    if not layout.several:
        return "distribution"
    if layout.population and layout.config.spin is not None and min(layout.config.spin.n_i) < 0:
        return "fractions"
    return "times" if set(TARGETS) & set(layout.several) else "ratio"
