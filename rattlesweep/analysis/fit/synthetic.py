"""Synthetic films of a stone, to plan a session or to try a fit."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from rattlesweep.analysis.fit.trials import follow_quantity
from rattlesweep.words.errors import ConfigError
from rattlesweep.words.units import quantity

if TYPE_CHECKING:
    import pandas as pd

    from rattlesweep.design.launch import Launch

FEWEST_FRAMES = 3
_MOST_FRAMES = 1_000_000


def synthetic_film(
    launch: Launch,
    seconds: str,
    fps: float,
    noise: str | None = None,
    seed: int = 0,
) -> pd.DataFrame:
    """Return the columns ``t_s`` and ``angle_deg`` of a film from above.

    The angle is that of the long axis from 0 to 180 degrees, with normal noise.  Raises
    a ConfigError if the launch is not whole, or a number is out of range.
    """
    import pandas as pd

    units = launch.body.units
    if units is None:
        raise ConfigError("body: a film needs one with a size; give it in SI units")
    for name in ("n_i", "omega_xy0"):
        if launch.omega is None and getattr(launch, name) is None:
            raise ConfigError(f"launch: {name} is missing; a film needs its value")
    length = _in_si("time", seconds, "time")
    if not (fps > 0 and FEWEST_FRAMES <= length * fps <= _MOST_FRAMES):
        raise ConfigError(
            f"fps: {seconds} at {fps:g} frames a second are {length * fps:.3g} frames; "
            f"from {FEWEST_FRAMES} to {_MOST_FRAMES:,} are possible"
        )
    t = np.arange(0, length, 1 / fps)
    times = t / units.time
    run = replace(launch, t_end=float(times[-1]))
    angle = np.degrees(follow_quantity(run, "angle", times))
    if noise is not None:
        spread = math.degrees(_in_si("noise", noise, "angle"))
        if spread < 0:
            raise ConfigError(f"noise: {noise} is below zero")
        angle = angle + spread * np.random.default_rng(seed).standard_normal(len(t))
    return pd.DataFrame({"t_s": t.round(6), "angle_deg": (angle % 180).round(4)})


def _in_si(name: str, text: str, kind: str) -> float:
    """Return a quantity in SI units; a ConfigError begins with its name."""
    try:
        return quantity(text, kind)
    except ValueError as error:
        raise ConfigError(f"{name}: {text!r} {error}") from None
