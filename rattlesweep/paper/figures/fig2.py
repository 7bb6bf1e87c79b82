"""Fig. 2: cumulative distributions of the pitch and the roll frequencies of the set SD."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa
from pydantic import Field

from rattlesweep.paper.figures.sd import distance, draw_modes, quantiles
from rattlesweep.paper.style import frame, new_figure
from rattlesweep.physics import theory
from rattlesweep.physics.body import shell_dumbbell
from rattlesweep.study.style import GREEN, ORANGE, SKY
from rattlesweep.sweeps.config.bodies import SdRanges
from rattlesweep.sweeps.config.fields import Base
from rattlesweep.sweeps.tables.columns import RATE, Column

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

FREQUENCIES = ("omega_p", "omega_r", "omega_p0", "omega_r0")
# The paper's lower bound of omega_p / omega_r (Methods).
BOUND = 1.3


class Fig2Settings(Base):
    """What Fig. 2 is made of."""

    seed: int = Field(default=2017, ge=0, le=2**63 - 1, description="Of the bodies.")
    samples: int = Field(default=1_000_000, ge=100, le=4_000_000, description="Bodies.")
    levels: int = Field(
        default=2001, ge=11, le=100_001, description="Points of each cumulative distribution."
    )
    ranges: SdRanges = Field(default_factory=lambda: SdRanges(), description="Of the bodies.")

    def quick(self) -> Fig2Settings:
        """A twentieth of the bodies."""
        return self.model_copy(update={"samples": max(100, self.samples // 20)})


def _number(name: str, description: str, unit: str = "1", *, whole: bool = False) -> Column:
    return Column(name, pa.int64() if whole else pa.float64(), unit, description)


CUMULATIVE = pa.schema(
    c.field
    for c in (
        _number("probability", "share of the bodies at or below the values of this row"),
        _number("omega_p", "pitch frequency (Eq. (24) [def-omega_pr])", RATE),
        _number("omega_r", "roll frequency (Eq. (24) [def-omega_pr])", RATE),
        _number("omega_p0", "pitch frequency at zero skew angle (Eq. (28) [omega_p0])", RATE),
        _number("omega_r0", "roll frequency at zero skew angle (Eq. (29) [omega_r0])", RATE),
        _number("ratio", "omega_p / omega_r"),
    )
)
SUMMARY = pa.schema(
    c.field
    for c in (
        _number("samples", "bodies", whole=True),
        _number("below", f"bodies with omega_p / omega_r at or below {BOUND}", whole=True),
        _number("ratio_bound", "infimum of omega_p / omega_r over the ranges"),
        *(
            column
            for mode, word in (("p", "pitch"), ("r", "roll"))
            for column in (
                _number(f"distance_{mode}", f"largest difference of the {word} distributions"),
                _number(f"off_median_{mode}", f"median of abs(omega_{mode}0/omega_{mode} - 1)"),
                _number(f"off_p99_{mode}", f"99th percentile of abs(omega_{mode}0/omega_{mode}-1)"),
            )
        ),
    )
)


def ratio_bound(ranges: SdRanges) -> float:
    """Infimum of ``omega_p / omega_r`` over ranges of bodies whose pitch is the faster mode.

    The product of the squares, ``det H``, does not depend on xi and their sum grows with ``sin^2
    xi``, so the ratio is least at the least skew angle.  There it depends on ``beta/alpha`` and
    ``(1/phi - 1)/(1/theta - 1)`` alone, monotonically in both, and the four pairs of their ends
    decide.  Where pitch and roll can change places this is 1, the bound of any ratio.
    """
    alpha, beta = shell_dumbbell(
        np.array([ranges.gamma[1], ranges.gamma[0]]), np.array([ranges.f_sd[0], ranges.f_sd[1]])
    )
    theta, phi = np.array(ranges.theta), np.array(ranges.phi[::-1])
    xi = -np.radians(ranges.minus_xi_deg[0])
    found = theory.modes(alpha[:, None], beta[:, None], theta, phi, xi)
    if np.any(found.omega_p0 <= found.omega_r0):
        return 1.0
    return float(np.min(found.omega_p / found.omega_r))


def compute(settings: Fig2Settings, report: Callable[[float, str], None]) -> dict[str, pa.Table]:
    """Data of the figure.

    Parameters
    ----------
    settings : Fig2Settings
    report : callable
        Called with the share that is done and a few words; what it raises ends the work.

    Returns
    -------
    dict
        ``cumulative``: values at equally spaced probabilities; ``summary``: one row.
    """
    found = draw_modes(
        FREQUENCIES, settings.samples, settings.seed, settings.ranges, report, share=0.8
    )
    found["ratio"] = found["omega_p"] / found["omega_r"]
    probability = np.linspace(0, 1, settings.levels)
    columns: dict[str, Any] = {"probability": probability}
    columns |= {name: quantiles(values, probability) for name, values in found.items()}
    summary: dict[str, Any] = {
        "samples": [settings.samples],
        "below": [int(np.count_nonzero(found["ratio"] <= BOUND))],
        "ratio_bound": [ratio_bound(settings.ranges)],
    }
    for mode in ("p", "r"):
        report(0.9, "comparing the distributions")
        exact, zeroth = found[f"omega_{mode}"], found[f"omega_{mode}0"]
        off = np.abs(zeroth / exact - 1)
        summary[f"distance_{mode}"] = [distance(exact, zeroth)]
        summary[f"off_median_{mode}"] = [float(np.median(off))]
        summary[f"off_p99_{mode}"] = [float(np.quantile(off, 0.99))]
    report(1.0, f"{settings.samples:,} bodies")
    return {
        "cumulative": pa.table(columns, schema=CUMULATIVE),
        "summary": pa.table(summary, schema=SUMMARY),
    }


def draw(tables: Mapping[str, pa.Table]) -> Any:
    """Draw the figure from its data."""
    data = {name: tables["cumulative"][name].to_numpy() for name in CUMULATIVE.names}
    level = data["probability"]
    figure = new_figure(4.6, 3.6)
    axes = figure.add_subplot()
    # Okabe and Ito's blue and vermilion; the approximations lie almost on top, so they are
    # dark, dashed and thin over something pale and broad.
    for mode, colour, dash in (("p", SKY, "#003F66"), ("r", ORANGE, "#7A2E00")):
        axes.plot(
            data[f"omega_{mode}"], level, color=colour, linewidth=3.2,
            solid_capstyle="butt", label=rf"$\omega_{mode}$",
        )  # fmt: skip
        axes.plot(
            data[f"omega_{mode}0"], level, color=dash, linewidth=1.1,
            linestyle=(0, (4, 2)), label=rf"$\omega_{{{mode}0}}$",
        )  # fmt: skip
    axes.set_xlim(0, 1.02 * data["omega_p"][-1])
    axes.set_ylim(0, 1.03)
    axes.set_xlabel(r"$\omega\,/\,\tilde\omega$")
    axes.set_ylabel("cumulative distribution")
    axes.legend(frameon=False, loc="upper right", bbox_to_anchor=(0.99, 0.9), ncols=2,
                handlelength=1.9, columnspacing=1.0)  # fmt: skip
    inset = axes.inset_axes((0.6, 0.19, 0.36, 0.42))
    inset.plot(data["ratio"], level, color=GREEN, linewidth=1.6)
    inset.axvline(BOUND, color="#444444", linewidth=0.8, linestyle=":")
    inset.annotate(
        f"{BOUND:g}", (BOUND, 0.93), xytext=(3, 0), textcoords="offset points",
        fontsize=7.5, color="#444444", va="center",
    )  # fmt: skip
    # The last percent of the ratios would fill half of the axis.
    inset.set_xlim(0, np.ceil(np.interp(0.995, level, data["ratio"])))
    inset.set_ylim(0, 1.05)
    inset.set_xlabel(r"$\omega_p/\omega_r$", fontsize=9, labelpad=1)
    for each in (axes, inset):
        frame(each)
    inset.tick_params(labelsize=7.5)
    return figure
