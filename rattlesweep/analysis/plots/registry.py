"""`plot`: the right picture of any output directory."""

from __future__ import annotations

from collections.abc import Sequence

from rattlesweep.errors import ConfigError
from rattlesweep.analysis.plots.distribution import Distribution
from rattlesweep.analysis.plots.fractions import Fractions
from rattlesweep.analysis.plots.layout import Layout, read_rows
from rattlesweep.analysis.plots.map import SIDE, Map
from rattlesweep.analysis.plots.picture import Picture
from rattlesweep.analysis.plots.reversals import Reversals
from rattlesweep.analysis.plots.scatter import Scatter, columns_of
from rattlesweep.analysis.plots.times import Ratio, Times
from rattlesweep.sweeps.config.messages import not_one_of

KINDS: dict[str, type[Picture]] = {
    kind.name: kind for kind in (Fractions, Times, Ratio, Map, Reversals, Distribution, Scatter)
}
"""Every kind of picture."""


def choose_picture(
    layout: Layout, kind: str | None = None, *, x: str | None = None, select: Sequence[str] = ()
) -> Picture:
    """Choose the picture that a sweep asks for, or take the one that is asked for.

    It is of no run yet: `read_rows` gives it the rows.  `x` is the axis that becomes the abscissa,
    or a column of the runs, which asks for a scatter; by default the axis with most values,
    coefficients before spins, and of a scatter ``t_rgh``.  `select` are ``NAME=VALUES`` texts.
    """
    layout = layout.select(select)
    if kind is None and x is not None and x not in layout.axes and x in columns_of(layout):
        kind = Scatter.name
    if x is not None and kind != Scatter.name:
        layout.named(x, f"--x {x}")
    fitting = [name for name, each in KINDS.items() if each.fits(layout)]
    if kind is not None and kind not in KINDS:
        raise ConfigError(f"--kind: {not_one_of(kind, fitting)}")
    if kind is not None and kind not in fitting:
        raise ConfigError(
            f"--kind {kind}: does not fit this sweep, {_why(layout)}; {', '.join(fitting)} fit"
        )
    return KINDS[kind or default_kind(layout)](layout, x)


def read_picture(
    layout: Layout,
    kind: str | None = None,
    *,
    x: str | None = None,
    select: Sequence[str] = (),
    where: str | None = None,
) -> Picture:
    """As `choose_picture`, of all runs, or of those for which a condition is true."""
    picture = choose_picture(layout.chosen(where), kind, x=x, select=select)
    read_rows(picture.layout, picture)
    return picture


def default_kind(layout: Layout) -> str:
    """A map for two long axes, shares of types where bodies are many, else reversal times.

    The map is of reversals where they are recorded.
    """
    long = [name for name, count in layout.lengths.items() if count >= SIDE]
    if len(long) >= 2 and (layout.grid or not layout.population):
        return Reversals.name if Reversals.fits(layout) else Map.name
    if max(layout.lengths.values(), default=1) < 2:
        return Distribution.name
    if layout.population and layout.config.spin is not None and min(layout.config.spin.n_i) < 0:
        return Fractions.name
    return (Times if any(layout.lengths[name] > 1 for name in layout.targets) else Ratio).name


def _why(layout: Layout) -> str:
    varying = [name for name, count in layout.lengths.items() if count > 1]
    what = " and ".join(varying) if varying else "nothing"
    many = "" if layout.population else ", one run each"
    return f"in which {what} var{'y' if len(varying) > 1 else 'ies'}{many}"
