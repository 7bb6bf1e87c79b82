"""Choose the right picture of an output directory."""

from __future__ import annotations

from collections.abc import Sequence

from rattlesweep.analysis.plots.curves import Fractions, Ratio, Times
from rattlesweep.analysis.plots.layout import Layout
from rattlesweep.analysis.plots.map import SIDE, Map, Reversals
from rattlesweep.analysis.plots.picture import Picture, numeric_columns
from rattlesweep.analysis.plots.runs import Distribution, Scatter
from rattlesweep.errors import ConfigError
from rattlesweep.sweeps.config.messages import not_one_of

KINDS: dict[str, type[Picture]] = {
    kind.name: kind for kind in (Fractions, Times, Ratio, Map, Reversals, Distribution, Scatter)
}


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

    Runs are read when the picture is first drawn, or its table asked for.

    Parameters
    ----------
    layout : Layout
        Of the sweep.
    kind : str, optional
        One of `KINDS`.
    x : str, optional
        The axis that becomes the abscissa, or a column of the runs, which asks for a scatter; by
        default the axis with most values, coefficients before spins, and ``t_rgh`` of a scatter.
    quantity : str, optional
        The column that a map or a distribution shows.
    select : sequence of str
        Texts such as ``n_i=-0.3,-0.5`` or ``theta=0.6:0.7``.
    where : str, optional
        A condition on the runs.

    Raises
    ------
    ConfigError
        The kind does not suit the sweep, or a name or a text cannot be read.
    """
    layout = layout.chosen(where).select(select)
    suited = default_kind(layout)
    if kind is None and x is not None and x not in layout.axes and x in numeric_columns(layout):
        kind = Scatter.name
    if x is not None and kind != Scatter.name:
        layout.named(x, f"--x {x}")
    fitting = [name for name, each in KINDS.items() if each.fits(layout)]
    if kind is not None and kind not in KINDS:
        raise ConfigError(f"--kind: {not_one_of(kind, fitting)}")
    if kind is not None and kind not in fitting:
        needs = "two quantities that vary in the config"
        if kind == Reversals.name:
            needs += ", and record: [reversals]"
        elif kind == Fractions.name:
            needs = "several bodies in each case, and something that varies by case"
        elif kind != Map.name:
            needs = "something that varies by case"
        raise ConfigError(
            f"--kind {kind}: does not fit this sweep: it needs {needs}; {', '.join(fitting)} fit"
        )
    if kind is None and quantity is not None:
        kind = Map.name if suited in (Map.name, Reversals.name) else Distribution.name
    if quantity is not None and kind not in (Map.name, Distribution.name):
        raise ConfigError(f"--quantity: goes with --kind map or distribution, not {kind}")
    return KINDS[kind or suited](layout, x, quantity)


def default_kind(layout: Layout) -> str:
    """Return the kind that suits a sweep.

    A map suits two long axes (of reversals where they are recorded), shares of types suit many
    bodies, reversal times the rest.
    """
    long = [name for name, count in layout.lengths.items() if count >= SIDE]
    if len(long) >= 2 and (layout.grid or not layout.population):
        return Reversals.name if Reversals.fits(layout) else Map.name
    if max(layout.lengths.values(), default=1) < 2:
        return Distribution.name
    if layout.population and layout.config.spin is not None and min(layout.config.spin.n_i) < 0:
        return Fractions.name
    return (Times if any(layout.lengths[name] > 1 for name in layout.targets) else Ratio).name
