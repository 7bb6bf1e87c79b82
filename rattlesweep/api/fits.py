"""Fits of runs to measured data, plans of such fits, and synthetic films."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from os import PathLike
from typing import TYPE_CHECKING, Any, TypeAlias

from rattlesweep.api import arguments as arguments
from rattlesweep.api.arguments import one_number
from rattlesweep.api.single import NumberOrText, launch_of
from rattlesweep.physics.body import Rattleback
from rattlesweep.system.console import Bar, counted
from rattlesweep.words.defaults import FILM_ERROR
from rattlesweep.words.errors import ConfigError, check_names
from rattlesweep.words.quantities import INITIAL_RATES, LOSSES

if TYPE_CHECKING:
    import pandas as pd

    OneFilm: TypeAlias = (
        str | PathLike[str] | pd.DataFrame | Mapping[str, Sequence[float]]
    )

    from rattlesweep.analysis.fit.joint import JointFit
    from rattlesweep.analysis.fit.measured import MeasuredBody, Prior
    from rattlesweep.analysis.fit.result import Fit
    from rattlesweep.design.launch import Launch


def fit(
    body: Rattleback | str | Mapping[str, Any],
    data: OneFilm | Sequence[OneFilm],
    *,
    free: Iterable[str],
    launch: Mapping[str, Any] | Sequence[Mapping[str, Any]] | None = None,
    error: NumberOrText | None = None,
    robust: bool = False,
    progress: bool | None = None,
    base: tuple[NumberOrText, NumberOrText] | Mapping[str, Any] | None = None,
    **losses: NumberOrText,
) -> Fit | JointFit:
    """Fit parameters of one run to a measured angle or spin, or to reversal times.

    A quantity that was measured otherwise may be a text with its standard error, such
    as ``"60 +- 1 g"`` (or ``±``).  It is then fitted, too, and its difference from the
    measured value, over the error, is one more residual.

    The 95 % intervals come from the Jacobian at the best fit.  They assume independent
    noise, of the size that `error` or a column says, or else of equal size, estimated
    from the residuals.

    A list of films is fitted together: each has its own launch, and what else is free
    is the same for all.  The noise is that of each film.

    Stability: stable.

    Parameters
    ----------
    body : Rattleback, str or mapping
        What is known of the body; with a size if the data are in seconds.  A mapping
        has the keys of a stone file, such as ``{"shape": "half_ellipsoid", "length":
        "12 +- 0.02 cm", ...}``.
    data : path, DataFrame or mapping of columns, or a list of these
        ``t_s`` (or ``t_ms``) and ``angle_deg``, ``spin_rpm``, ``n_rpm`` or
        ``gyro_rad_s`` (about the stone's own upward axis), an export of Tracker,
        Kinovea, phyphox and others with these quantities, two marks
        ``x1_px, y1_px, x2_px, y2_px``; or ``reversal_s`` alone. ``t`` and ``n`` are in
        the units of the body.  The angle is that of the long axis, counterclockwise
        seen from above, and may jump by half turns; the spin is its central difference,
        and n is ``u . omega``.  The launch is the first row after rows of rest, or time
        0.  A column such as ``angle_error_deg`` has the standard errors.
    free : sequence of str
        Parameters to fit, of ``n_i, omega_xy0, psi_deg, sigma, rolling, pivot,
        creep, viscous, mu, skew`` (which is ``-xi``), ``xi, theta, phi, alpha, beta,
        gamma, c``, with `base` also ``base_acceleration, base_phase``, and of a mapping
        ``length, width, height, mass, weights, wall, axes_angle, f_sd``.  The search
        begins at their given values.
    launch : mapping
        ``n_i, omega_xy0, psi`` or ``omega, u``; free parameters may be left out. For
        several films also a list.
    error : number or str, optional
        Standard error of all values, in the unit of the column or with a unit.
    robust : bool
        Whether to leave out rows that are far off all others; a remark names them.
    progress : bool, optional
        Whether to show a bar, by default in a terminal and in a notebook.
    base : tuple or mapping, optional
        A plane that shakes, as for ``simulate``; its phase is that of time 0.
    **losses
        Dissipation, as for ``simulate``: ``sigma``, ``rolling``, ``pivot``,
        ``creep``, ``viscous`` and ``mu``.

    Raises
    ------
    ConfigError
        If an argument or the data are wrong, or the data are too few.
    """
    options: dict[str, Any] = {"body": body, "free": free, "base": base, **losses}
    options |= {"launch": launch, "error": error, "robust": robust}
    with Bar.of_call(progress) as bar:
        if isinstance(data, list | tuple):
            return fit_films(bar, data, **options)
        one: Any = data
        return fit_with_progress(bar, one, **options)


def fit_films(
    bar: Bar, data: Sequence[OneFilm], *, launch: Any, **options: Any
) -> JointFit:
    """Fit several films together as :func:`fit` does, and show the progress."""
    from rattlesweep.analysis.fit.joint import fit_together

    launches = launch
    if not isinstance(launch, list | tuple):
        launches = [launch] * len(data)
    if len(launches) != len(data) or len(data) < 2:
        raise ConfigError(
            f"launch: {counted(len(data), 'film')} with {len(launches)} of launches; "
            "give two films or more, and one launch for all or one for each"
        )
    fits = [
        fit_with_progress(bar, one, launch=own, **options)
        for one, own in zip(data, launches, strict=True)
    ]
    return fit_together(fits)


def fit_with_progress(
    bar: Bar,
    data: OneFilm,
    *,
    error: NumberOrText | None = None,
    robust: bool = False,
    **asked: Any,
) -> Fit:
    """Fit as :func:`fit` does, and show the progress on a bar."""
    from rattlesweep.analysis.fit.film import read_film
    from rattlesweep.analysis.fit.launched import from_the_launch
    from rattlesweep.analysis.fit.search import fit_run
    from rattlesweep.compiling.loading import listening

    if isinstance(data, Mapping):
        arguments.refuse_units_of_columns("data", data)
    run, stone, priors, names = _to_fit(**asked)
    film = read_film(data, run.body.units, error, run.n_i)
    film = from_the_launch(film, run.n_i)
    with listening(bar.compiling):
        return fit_run(run, film, names, bar.working("fit"), stone, priors, robust)


def plan_of_fit(
    *, seconds: str, fps: float, error: NumberOrText | None = None, **asked: Any
) -> Fit:
    """Return the fit that a film of the given values would have, at its best."""
    from rattlesweep.analysis.fit.film import read_film
    from rattlesweep.analysis.fit.search import planned_fit
    from rattlesweep.analysis.fit.synthetic import synthetic_film

    run, stone, priors, names = _to_fit(**asked)
    table = synthetic_film(run, seconds, fps)
    film = read_film(table, run.body.units, error or FILM_ERROR, run.n_i)
    return planned_fit(run, film, names, stone, priors)


def film_of(
    *, seconds: str, fps: float, error: str, seed: int, **asked: Any
) -> pd.DataFrame:
    """Return a synthetic film of a stone."""
    from rattlesweep.analysis.fit.synthetic import synthetic_film

    run, _, _, _ = _to_fit(free=["n_i"], **asked)
    return synthetic_film(run, seconds, fps, error, seed)


def _to_fit(
    *,
    body: object,
    free: Iterable[str],
    launch: Any,
    base: object = None,
    **losses: Any,
) -> tuple[Launch, MeasuredBody, dict[str, Prior], list[str]]:
    """Return the run of a fit, its body, priors and free parameters."""
    from rattlesweep.analysis.fit.measured import separate
    from rattlesweep.analysis.fit.search import check_free

    launch = launch or {}
    if not isinstance(launch, Mapping):
        raise ConfigError(f"launch: {arguments.kind_of(launch)} is not a mapping")
    check_names("launch", launch, (*INITIAL_RATES, "psi", "omega", "u"))
    check_names("arguments", losses, LOSSES)
    stone = arguments.measured_from(body)
    values, errors = separate({**launch, **losses})
    run = launch_of(stone.body, base=base, **values)
    priors = {**stone.priors, **_priors(run, errors)}
    wanted = arguments.names_of("free", free)
    # What was measured with an error is free as well.
    wanted = [*wanted, *(name for name in priors if name not in wanted)]
    return run, stone, priors, check_free(run, wanted, stone)


def _priors(run: Launch, errors: Mapping[str, NumberOrText]) -> dict[str, Prior]:
    """Return the priors of a launch and its dissipation, in units of the body."""
    from rattlesweep.analysis.fit.measured import Prior

    priors = {}
    for name, error in errors.items():
        width = one_number(name, error, run.body.units)
        value = run.losses.get(name, getattr(run, name, None))
        assert isinstance(value, float)
        assert width is not None
        # The direction is in degrees.
        priors["psi_deg" if name == "psi" else name] = Prior(value, width)
    return priors
