"""Fig. 3: distributions of the torque coefficients K_p and K_r of the set SD."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import pyarrow as pa
from pydantic import Field, field_validator

from rattlesweep.paper.figures.density import Grid, count_bodies
from rattlesweep.paper.figures.fig2 import BOUND
from rattlesweep.paper.figures.sd import draw_modes, quantiles, ranges_array
from rattlesweep.paper.style import frame, new_figure
from rattlesweep.study.style import BLUE, VERMILION
from rattlesweep.sweeps.config.bodies import SdRanges
from rattlesweep.sweeps.config.fields import Base
from rattlesweep.sweeps.tables.columns import Column

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from numpy.typing import NDArray

# The paper's colour code: nine decades.
DECADES = 9


class Fig3Settings(Base):
    """What Fig. 3 is made of.

    The paper names a logarithmic scale for the colours only, hence the linear axes.
    """

    seed: int = Field(default=2017, ge=0, le=2**63 - 1, description="Of the bodies.")
    samples: int = Field(default=100_000, ge=100, le=4_000_000, description="Bodies of part (a).")
    density_samples: int = Field(
        default=100_000_000, ge=100, le=10**11, description="Bodies of part (b)."
    )
    levels: int = Field(
        default=2001, ge=11, le=100_001, description="Points of each cumulative distribution."
    )
    scale: Literal["linear", "log"] = Field(default="linear", description="Of the axes.")
    K_p: list[float] = Field(
        default=[0.0, 7.0], validate_default=True, description="Ends of the axis of part (b)."
    )
    K_r: list[float] = Field(
        default=[0.0, 0.4], validate_default=True, description="Ends of the axis of part (b)."
    )
    bins: int = Field(default=200, ge=10, le=1000, description="Bins on each axis of part (b).")
    ranges: SdRanges = Field(default_factory=lambda: SdRanges(), description="Of the bodies.")

    @field_validator("K_p", "K_r")
    @classmethod
    def _ends(cls, ends: list[float], info: Any) -> list[float]:
        if len(ends) != 2 or not 0 <= ends[0] < ends[1]:
            raise ValueError("an axis has two ends, [low, high] with 0 <= low < high")
        if ends[0] == 0 and info.data.get("scale") == "log":
            raise ValueError("a logarithmic axis begins above 0; write a positive lower end")
        return ends

    def quick(self) -> Fig3Settings:
        """A fiftieth of the bodies of part (b)."""
        return self.model_copy(update={"density_samples": max(100, self.density_samples // 50)})


def _number(name: str, description: str, *, whole: bool = False) -> Column:
    return Column(name, pa.int64() if whole else pa.float64(), "1", description)


CUMULATIVE = pa.schema(
    c.field
    for c in (
        _number("probability", "share of the bodies at or below the values of this row"),
        _number("K_p", "torque coefficient of the pitch (Eq. Kp)"),
        _number("K_r", "torque coefficient of the roll (Eq. Kr)"),
        _number("ratio", "K_p / K_r"),
    )
)
DENSITY = pa.schema(
    c.field
    for c in (
        _number("i", "number of the bin of K_p", whole=True),
        _number("j", "number of the bin of K_r", whole=True),
        _number("K_p_low", "lower edge of the bin"),
        _number("K_p_high", "upper edge of the bin"),
        _number("K_r_low", "lower edge of the bin"),
        _number("K_r_high", "upper edge of the bin"),
        _number("count", "bodies in the bin; bins without any have no row", whole=True),
        _number("relative_frequency", "count / samples: the paper's P(K_p, K_r)"),
    )
)
SUMMARY = pa.schema(
    c.field
    for c in (
        _number("samples", "bodies of the cumulative distributions", whole=True),
        _number("density_samples", "bodies of the density", whole=True),
        _number("outside", "of these, outside the bins", whole=True),
        _number("ratio_min", "of these, the least omega_p / omega_r"),
        _number("below", f"of these, with omega_p / omega_r below {BOUND}", whole=True),
        _number("bins", "bins on each axis", whole=True),
        *(
            _number(f"{name}_{end}", f"{word} end of the binned axis of {name}")
            for name in ("K_p", "K_r")
            for end, word in (("low", "lower"), ("high", "upper"))
        ),
        Column("scale", pa.string(), "1", "of the axes: linear or log"),
    )
)


def compute(
    settings: Fig3Settings, report: Callable[[float, str], None], threads: int | None = None
) -> dict[str, pa.Table]:
    """Data of the figure.

    Parameters
    ----------
    settings : Fig3Settings
    report : callable
        Called with the share that is done and a few words; what it raises ends the work.
    threads : int, optional
        By default all; the data are the same for any number.

    Returns
    -------
    dict
        ``cumulative``: values at equally spaced probabilities; ``density``: bins that hold
        bodies; ``summary``: one row.
    """
    # A body of part (a) takes ten times as long as one of part (b).
    early = 10 * settings.samples / (10 * settings.samples + settings.density_samples)
    found = draw_modes(
        ("K_p", "K_r"), settings.samples, settings.seed, settings.ranges, report, share=early
    )
    found["ratio"] = found["K_p"] / found["K_r"]
    probability = np.linspace(0, 1, settings.levels)
    cumulative: dict[str, Any] = {"probability": probability}
    cumulative |= {name: quantiles(values, probability) for name, values in found.items()}
    grid = Grid(
        K_p=(settings.K_p[0], settings.K_p[1]),
        K_r=(settings.K_r[0], settings.K_r[1]),
        bins=settings.bins,
        log=settings.scale == "log",
    )
    total = settings.density_samples
    spread = count_bodies(
        total,
        settings.seed,
        ranges_array(settings.ranges),
        grid,
        limit=BOUND,
        threads=threads,
        report=lambda done: report(
            early + (1 - early) * done, f"{round(done * total):,} of {total:,} bodies"
        ),
    )
    i, j = np.nonzero(spread.counts)
    p, r = grid.edges("K_p"), grid.edges("K_r")
    count = spread.counts[i, j]
    density = {
        "i": i, "j": j,
        "K_p_low": p[i], "K_p_high": p[i + 1], "K_r_low": r[j], "K_r_high": r[j + 1],
        "count": count, "relative_frequency": count / total,
    }  # fmt: skip
    summary = {
        "samples": [settings.samples],
        "density_samples": [total],
        "outside": [spread.outside],
        "ratio_min": [spread.least_ratio],
        "below": [spread.below],
        "bins": [settings.bins],
        "K_p_low": [settings.K_p[0]], "K_p_high": [settings.K_p[1]],
        "K_r_low": [settings.K_r[0]], "K_r_high": [settings.K_r[1]],
        "scale": [settings.scale],
    }  # fmt: skip
    return {
        "cumulative": pa.table(cumulative, schema=CUMULATIVE),
        "density": pa.table(density, schema=DENSITY),
        "summary": pa.table(summary, schema=SUMMARY),
    }


def grid_of(tables: Mapping[str, pa.Table]) -> Grid:
    """Bins of the density of the figure's tables."""
    row = tables["summary"].to_pylist()[0]
    return Grid(
        K_p=(row["K_p_low"], row["K_p_high"]),
        K_r=(row["K_r_low"], row["K_r_high"]),
        bins=row["bins"],
        log=row["scale"] == "log",
    )


def counts_of(tables: Mapping[str, pa.Table]) -> NDArray[np.int64]:
    """Histogram of the figure's tables, shape (bins, bins), by ``K_p`` and ``K_r``."""
    bins = tables["summary"]["bins"][0].as_py()
    counts = np.zeros((bins, bins), dtype=np.int64)
    data = tables["density"]
    counts[data["i"].to_numpy(), data["j"].to_numpy()] = data["count"].to_numpy()
    return counts


def _cumulative(
    axes: Any, data: Mapping[str, Any], ends: tuple[float, float], *, log: bool
) -> None:
    for name, colour, style in (("K_p", BLUE, "-"), ("K_r", VERMILION, (0, (5, 1.5)))):
        axes.plot(data[name], data["probability"], color=colour, linestyle=style,
                  linewidth=1.8, label=f"${name}$")  # fmt: skip
    axes.set_xscale("log" if log else "linear")
    axes.set_xlim(*ends)
    axes.set_ylim(0, 1.03)
    frame(axes)


def draw(tables: Mapping[str, pa.Table]) -> Any:
    """Draw the figure from its data."""
    from matplotlib import colormaps

    figure = new_figure(4.6, 7.2)
    upper, lower = figure.subplots(2, 1, height_ratios=(1, 1.25))
    data = {name: tables["cumulative"][name].to_numpy() for name in CUMULATIVE.names}
    grid = grid_of(tables)
    _cumulative(upper, data, (grid.K_r[0], grid.K_p[1]), log=grid.log)
    upper.set_xlabel("$K_p$,  $K_r$")
    upper.set_ylabel("cumulative distribution")
    if grid.log:
        upper.legend(frameon=False, loc="upper left")
    else:
        upper.legend(frameon=False, loc="upper right", bbox_to_anchor=(1, 0.93), ncols=2)
        # K_r is steep on the axis of K_p: the same again over decades.
        inset = upper.inset_axes((0.47, 0.18, 0.5, 0.52))
        _cumulative(inset, data, (1e-4, 10.0), log=True)
        inset.tick_params(labelsize=7.5)
        inset.minorticks_off()

    total = tables["summary"]["density_samples"][0].as_py()
    counts = counts_of(tables)
    shown = np.full(counts.shape, np.nan)
    np.log10(counts / total, where=counts > 0, out=shown)
    picture = lower.pcolormesh(
        grid.edges("K_p"), grid.edges("K_r"), shown.T, cmap=colormaps["viridis"],
        vmin=-DECADES, vmax=0, rasterized=True,
    )  # fmt: skip
    if grid.log:
        lower.set_xscale("log")
        lower.set_yscale("log")
    lower.set_xlabel("$K_p$")
    lower.set_ylabel("$K_r$")
    bar = figure.colorbar(picture, ax=lower, ticks=range(-DECADES, 1), pad=0.02)
    bar.set_label(r"$\log_{10} P(K_p, K_r)$")
    frame(lower)
    for axes, letter in ((upper, "(a)"), (lower, "(b)")):
        axes.set_title(letter, loc="left", fontsize=11)
    return figure
