"""Random bodies without a sweep: those that a sweep with the same seed has."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Literal

import numpy as np

from rattlesweep.api.arguments import check_count
from rattlesweep.physics.body import PARAMETERS

if TYPE_CHECKING:
    import pandas as pd


def draw_bodies(
    samples: int,
    *,
    seed: int = 0,
    first: int = 0,
    ranges: Mapping[str, Sequence[float]] | None = None,
    draw: Literal["random", "sobol"] = "random",
) -> pd.DataFrame:
    """Return random shell-dumbbell bodies, those of ``bodies: {source: sd}``.

    A body is a function of seed, sample and ranges alone, so a sweep without a target
    has the same ones.

    Stability: stable.

    Parameters
    ----------
    samples : int
        Number of bodies.
    seed : int
        The `seed` of a config.
    first : int
        Number of the first sample, with which many bodies can be drawn in parts.
    ranges : mapping, optional
        Lower and upper ends of ``gamma``, ``f_sd``, ``theta``, ``phi`` and
        ``minus_xi_deg``, in degrees; by default those of Kondo and Nakanishi (2017),
        Table I.
    draw : {"random", "sobol"}
        ``sobol`` fills the ranges more evenly.

    Returns
    -------
    DataFrame
        A row for each body, with ``alpha beta gamma theta phi xi f_sd``.

    Raises
    ------
    ConfigError
        If a range is not possible.

    Examples
    --------
    >>> bodies = rs.draw_bodies(1000, seed=2017)
    >>> bool((rs.modes(bodies).K_p > rs.modes(bodies).K_r).all())
    True
    """
    import pandas as pd

    from rattlesweep.config.read import parse_config
    from rattlesweep.design.bodies.sources import make_source

    check_count("samples", samples)
    check_count("first", first, least=0)
    bodies = {
        "source": "sd",
        "samples": first + samples,
        "ranges": {**(ranges or {})},
        "draw": draw,
    }
    # The launch is not used.
    spin = {"n_i": 0.1, "omega_xy0": 0.01}
    config = parse_config({"seed": seed, "bodies": bodies, "spin": spin})
    source = make_source(config, None, None)
    drawn = source.bodies(np.nan, np.arange(first, first + samples))
    names = [*PARAMETERS, "f_sd"]
    return pd.DataFrame({name: getattr(drawn, name) for name in names})
