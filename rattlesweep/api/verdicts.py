"""Whether a stone turns back: the runs of a verdict, and their table."""

from __future__ import annotations

import html
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from rattlesweep.api import arguments as arguments
from rattlesweep.api.arguments import check_count
from rattlesweep.config.clashes import refuse_slip_beside
from rattlesweep.physics import si
from rattlesweep.physics.body import Rattleback
from rattlesweep.physics.si import Units
from rattlesweep.system.console import Bar
from rattlesweep.words.defaults import (
    PATCH_FRICTION,
    VERDICT_PUSH,
    VERDICT_SPINS,
    VERDICT_STONES,
    VERDICT_TIME,
)
from rattlesweep.words.errors import ConfigError, check_names, one_line
from rattlesweep.words.quantities import LOSSES
from rattlesweep.words.units import require_unit

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

    from rattlesweep.analysis.fit.measured import MeasuredBody

RPM = np.pi / 30  # in rad/s
VERDICT_TOL = 1e-9
TIGHTER = 1e-11  # tolerance of the runs that tell the error of the others
# Of the time of a failure: where a run ends that is repeated to learn what came before.
EARLIER = 1 - 1e-6


@dataclass(frozen=True)
class Verdict:
    """Whether a stone turns back: in words, and as the DataFrame `table`.

    A row is a launch in one direction, without friction or with all that is given:

    ``friction``
        ``none``, or the losses in words.
    ``direction``, ``spin_rpm``
        The launch.
    ``outcome``
        ``turns back``; ``hardly turns back``: the spin on the other side stays below a
        quarter of the launch; ``stops``: friction holds the spin, or has taken nearly
        all of the energy; ``spins on`` or ``wobbles on`` to the end; ``lifts off``,
        ``jams`` or ``rolls past its rim`` before anything else.
    ``t_s``, ``error_s``
        Time at which the spin passes zero, and the error of the integration: the
        difference from a run whose tolerance is a hundred times tighter.
    ``reversals``, ``after_rpm``
        Their number by the end, and the largest spin after the first of them.
    ``held_s``, ``slides_s``
        Time at which pivoting friction holds the spin at zero for the first time, and
        at which the first slide begins.
    ``end_s``, ``status``
        End of the run, and its status as in ``runs``.
    ``samples``, ``share``, ``low_s``, ``high_s``
        Number of stones drawn from the errors of what was measured, the share of them
        that turn back, and the interval of 95 % of their times.
    ``sure``
        Whether the tighter run and all samples agree on whether it turns back, and the
        error is below 1e-3 of the time.

    `remarks` are sentences on what the table does not show.  `advice`, a DataFrame,
    says what would make launches turn back with all friction; each row is a run:

    ``direction``, ``spin_rpm``
        The launch: the smallest spin found that turns back, or one that does not.
    ``change``, ``value``, ``unit``, ``before``
        ``spin``, ``skew``, ``lever`` or ``weights``, how large it must be, and is now.
    ``words``
        The same in words.
    ``t_s``, ``sure``
        When it turns back then, and whether a tighter run agrees.

    Stability: stable.
    """

    table: pd.DataFrame
    sentence: str
    remarks: tuple[str, ...] = ()
    advice: pd.DataFrame | None = None
    _body: Rattleback = field(repr=False, kw_only=True)
    _launches: pd.DataFrame = field(repr=False, kw_only=True)
    _losses: Mapping[str, Mapping[str, Any]] = field(repr=False, kw_only=True)

    def __str__(self) -> str:
        from rattlesweep.analysis.verdict import advice_as_text, table_as_text

        text = f"{self.sentence}\n\n{table_as_text(self.table)}"
        if self.advice is not None and len(self.advice):
            text += f"\n\n{advice_as_text(self.advice)}"
        return text

    __repr__ = __str__

    def to_dict(self) -> dict[str, Any]:
        """Return the verdict as plain data, with None where the table has no number."""
        return {
            "verdict": self.sentence,
            "runs": _records(self.table),
            "advice": _records(self.advice),
            "remarks": list(self.remarks),
        }

    def _repr_html_(self) -> str:
        return f"<p>{html.escape(self.sentence)}</p>{self.table.to_html(index=False)}"

    def plot(self, path: str | Path | None = None) -> Figure:
        """Draw the spin of each launch over time, and write the figure to a `path`."""
        from rattlesweep.analysis.onerun.course import Course
        from rattlesweep.analysis.verdict import SpinCurve, draw_verdict
        from rattlesweep.api.single import prepare_launch

        curves = []
        for friction, losses in self._losses.items():
            for launch in self._launches.to_dict("records"):
                run = prepare_launch(
                    self._body,
                    n_i=f"{launch['n_i_rpm']!r} rpm",
                    omega_xy0=f"{launch['omega_xy0_rpm']!r} rpm",
                    t_end=f"{launch['t_end_s']!r} s",
                    **losses,
                )
                columns = Course(run, ["t", "n"], watched=False).columns()
                curves.append(
                    SpinCurve(
                        friction, launch["n_i_rpm"], columns["t_s"], columns["n_rpm"]
                    )
                )
        return draw_verdict(self.table, curves, self.sentence, path, self.advice)


def _records(table: pd.DataFrame | None) -> list[dict[str, Any]]:
    """Return the rows of a table, with None where it has no number."""
    if table is None:
        return []
    rows = table.astype(object).where(table.notna(), None).to_dict("records")
    return [{str(name): value for name, value in row.items()} for row in rows]


def verdict(
    body: Rattleback | str | Mapping[str, Any],
    *,
    spin: str | Sequence[str] = VERDICT_SPINS,
    push: str = VERDICT_PUSH,
    t_end: str = VERDICT_TIME,
    samples: int = VERDICT_STONES,
    length: float | str | None = None,
    advice: bool = True,
    progress: bool | None = None,
    **losses: Any,
) -> Verdict:
    """Tell whether a stone turns back in both directions, when, and how sure that is.

    Each spin is launched in both directions, once without friction and once with the
    losses that are given.  A patch that pivots also creeps: with the friction `creep`,
    by default `mu`, or else 0.3.

    Stability: stable.

    Parameters
    ----------
    body : Rattleback, str or mapping
        A body with a size, or its keys as for ``fit``, such as ``{"shape":
        "half_ellipsoid", "length": "12 +- 0.02 cm", ...}``.
    spin : str or sequence of str
        Spins of the launches, in both directions.
    push : str
        Initial oscillation along the relevant mode, which a hand always gives: 6 rpm
        tilt a stone of 12 cm by about 1 degree.
    t_end : str
        How long the stone is watched.
    samples : int
        Number of stones that are drawn from the errors of what was measured, if it has
        any.
    length : float or str, optional
        Height of the centre of mass, which a body without a size needs.
    advice : bool
        Whether to look for what would make it turn back, with about a hundred runs.
    progress : bool, optional
        Whether to show a bar, by default in a terminal and in a notebook.
    **losses
        Dissipation, as for ``fit``: ``sigma``, ``rolling``, ``pivot``, ``creep``,
        ``viscous`` and ``mu``, each perhaps with an error.

    Raises
    ------
    ConfigError
        If an argument is wrong, or the body has no size.

    Examples
    --------
    >>> stone = rs.Rattleback.half_ellipsoid(
    ...     length="12 cm", width="3 cm", height="12 mm", mass="60 g", skew="3 deg")
    >>> found = rs.verdict(stone, spin="60 rpm", pivot="54 um")
    >>> found.table[["direction", "friction", "outcome", "t_s"]].round(2)
              direction                friction            outcome   t_s
    0  counterclockwise                    none         turns back  1.09
    1  counterclockwise  pivot 54 um, creep 0.3         turns back  1.08
    2         clockwise                    none         turns back  4.74
    3         clockwise  pivot 54 um, creep 0.3  hardly turns back  5.41
    """
    from rattlesweep.compiling.loading import listening

    with Bar.of_call(progress) as bar, listening(bar.compiling):
        return verdict_on(
            body,
            spin,
            push,
            t_end,
            samples=samples,
            length=length,
            advice=advice,
            **losses,
        )


def verdict_on(
    body: object,
    spin: str | Sequence[str],
    push: str,
    t_end: str,
    *,
    samples: int = VERDICT_STONES,
    length: float | str | None = None,
    advice: bool = True,
    **losses: Any,
) -> Verdict:
    """Return a verdict as :func:`verdict` does, without a bar."""
    import pandas as pd

    from rattlesweep.analysis.verdict import (
        CLOCKWISE,
        COUNTERCLOCKWISE,
        NO_FRICTION,
        judged,
        outcomes,
        sentence_of,
    )

    stone = _sized(body, length)
    check_count("samples", samples)
    if losses.pop("base", None) is not None:
        raise ConfigError("base: a verdict is about a plane at rest; leave base out")
    check_names("arguments", losses, LOSSES)
    launches = _launches(stone.body, spin, push, t_end)
    given, values, errors = _separate(losses)
    refuse_slip_beside(values)
    remarks = []
    if "pivot" in values and given.get("creep") is None and "mu" not in values:
        # With mu the patch creeps with the friction of slides (`Dissipation`).
        given["creep"] = values["creep"] = PATCH_FRICTION
        remarks.append(
            f"the friction in the patch of contact is taken as {PATCH_FRICTION:g}; "
            "give creep, or creep 0 for a patch that does not give way"
        )
    _require_mass(stone.body, values)
    drawn, doubts = _drawn(stone, values, errors, samples)
    remarks += doubts
    alternatives: dict[str, dict[str, Any]] = {NO_FRICTION: {}}
    if values:
        words = ", ".join(f"{name} {losses.get(name, given[name])}" for name in values)
        alternatives[words] = {name: given[name] for name in values}
    parts = []
    for friction, own in alternatives.items():
        stones = [
            (each, {name: constants[name] for name in own}) for each, constants in drawn
        ]
        rows = _rows_of_stones(stones).merge(launches, how="cross")
        found = outcomes(_integrated(rows, VERDICT_TOL))
        tighter = outcomes(_integrated(rows.iloc[: len(launches)], TIGHTER))
        part = judged(found, tighter, VERDICT_TOL)
        part.insert(0, "friction", friction)
        is_positive = launches["n_i_rpm"] > 0
        part.insert(1, "direction", np.where(is_positive, COUNTERCLOCKWISE, CLOCKWISE))
        part.insert(2, "spin_rpm", launches["n_i_rpm"].abs())
        parts.append(part)
    # The two frictions of a launch follow each other.
    table = pd.concat(parts).sort_index(kind="stable").reset_index(drop=True)
    end = float(launches["t_end_s"].iloc[0])
    rows = table[table["friction"] == friction]
    advised = None
    if advice:
        advised = _advice(stone.body, values, launches, rows)
    return Verdict(
        table,
        sentence_of(rows, end),
        tuple(remarks),
        advised,
        _body=stone.body,
        _launches=launches,
        _losses=alternatives,
    )


def _advice(
    body: Rattleback,
    losses: Mapping[str, float],
    launches: pd.DataFrame,
    rows: pd.DataFrame,
) -> pd.DataFrame:
    """Return what would make launches turn back that do not, in rows with friction."""
    import pandas as pd

    from rattlesweep.analysis.verdict import SIGN_OF_DIRECTION, TURNS, outcomes
    from rattlesweep.api.changes import Trial, changes

    def tries(trials: Sequence[Trial], is_check: bool) -> pd.DataFrame:
        its = _rows_of_stones([(each.body, each.losses) for each in trials])
        its["n_i_rpm"] = [each.n_i_rpm for each in trials]
        for name in ("omega_xy0_rpm", "t_end_s"):
            its[name] = float(launches[name].iloc[0])
        found = outcomes(_integrated(its, TIGHTER if is_check else VERDICT_TOL))
        return pd.DataFrame({"turns": found["outcome"] == TURNS, "t_s": found["t_s"]})

    failing: dict[str, list[float]] = {}
    for direction in rows["direction"].unique():
        fails = (rows["direction"] == direction) & (rows["outcome"] != TURNS)
        sign = SIGN_OF_DIRECTION[direction]
        failing[direction] = [sign * spin for spin in rows.loc[fails, "spin_rpm"]]
    most = float(rows["spin_rpm"].max())
    found = list(changes(failing, body, losses, most, tries))
    names = ("direction", "spin_rpm", "change", "value", "unit", "before", "words")
    table = pd.DataFrame(
        [[getattr(each, name) for name in names] for each in found],
        columns=pd.Index(names),
    )
    checked = pd.DataFrame({"turns": [], "t_s": []})
    if found:
        checked = tries([each.trial for each in found], True)
    return table.assign(t_s=checked["t_s"], sure=checked["turns"].astype(bool))


def _rows_of_stones(
    stones: Sequence[tuple[Rattleback, Mapping[str, float]]],
) -> pd.DataFrame:
    """Return bodies and their losses in SI units as rows of a table."""
    import pandas as pd

    bodies = pd.DataFrame(arguments.body_columns([body for body, _ in stones]))
    losses = pd.DataFrame([dict(each) for _, each in stones]).rename(columns=_column)
    # A size may be without a mass.
    return bodies.dropna(axis=1, how="all").join(losses)


def _sized(body: object, length: float | str | None) -> MeasuredBody:
    """Return a body and its errors; without a size of its own, of that of `length`."""
    from rattlesweep.design.bodies.making import missing_height

    stone = arguments.measured_from(body)
    needed = missing_height(stone.body.units, length)
    if needed is None:
        return stone
    height = _in_si("length", needed, "length")
    return replace(stone, body=stone.body.replace(units=Units(np.nan, height)))


def _in_si(name: str, value: Any, kind: str) -> float:
    """Return a quantity, which needs a unit, in SI units."""
    require_unit(name, value, kind, of_size=True)
    try:
        return si.number(value, kind, name)
    except ValueError as error:
        raise ConfigError(str(error)) from None


def _launches(
    body: Rattleback, spin: str | Sequence[str], push: str, t_end: str
) -> pd.DataFrame:
    """Return the launches in both directions, the unsteady one first."""
    import pandas as pd

    given = [spin] if isinstance(spin, str) or not hasattr(spin, "__len__") else spin
    spins = sorted({abs(_in_si("spin", each, "spin")) / RPM for each in given})
    if not spins or not spins[0]:
        raise ConfigError("spin: a spin above zero is needed, such as 60 rpm")
    assert body.units is not None
    si.check_spins("spin", np.array(spins) * RPM * body.units.time, body.units)
    sense = 1.0 if body.xi < 0 else -1.0
    signed = [sign * each for sign in (sense, -sense) for each in spins]
    return pd.DataFrame(
        {
            # Texts such as 60 rpm become 60.0, without the rounding of the units.
            "n_i_rpm": [float(f"{each:.12g}") for each in signed],
            "omega_xy0_rpm": float(f"{_in_si('push', push, 'spin') / RPM:.12g}"),
            "t_end_s": _in_si("t_end", t_end, "time"),
        }
    )


def _column(loss: str) -> str:
    """Return the column of a table of bodies that has a loss in SI units."""
    measure = LOSSES[loss].measure
    return loss if measure is None else measure.name


def _separate(
    losses: Mapping[str, Any],
) -> tuple[dict[str, Any], dict[str, float], dict[str, float]]:
    """Return losses without their errors, and both in SI units.

    Losses of zero are left out in SI units.
    """
    from rattlesweep.analysis.fit.measured import separate

    given = {name: value for name, value in losses.items() if value is not None}
    plain, errors_given = separate(given)
    values = {}
    errors = {}
    for name, value in plain.items():
        size = _loss(name, value)
        if size or name in errors_given:
            values[name] = size
        if name in errors_given:
            errors[name] = _loss(name, errors_given[name])
    return plain, values, errors


def _require_mass(body: Rattleback, losses: Iterable[str]) -> None:
    """Refuse losses in kg for a body whose mass is unknown."""
    for name in losses:
        if "M" in LOSSES[name].unit and body.units and np.isnan(body.units.mass):
            raise ConfigError(
                f"{name}: the body has no mass, in which {name} is measured; leave "
                f"{name} out"
            )


def _loss(name: str, value: Any) -> float:
    """Return a loss in SI units."""
    kind = LOSSES[name].kind
    if kind:
        return _in_si(name, value, kind)
    number = arguments.one_number(name, value)
    assert number is not None
    return number


_Drawn = list[tuple[Rattleback, dict[str, float]]]


def _drawn(
    stone: MeasuredBody,
    losses: Mapping[str, float],
    errors: Mapping[str, float],
    samples: int,
) -> tuple[_Drawn, list[str]]:
    """Return a stone and its losses, and those drawn from what was measured.

    Also returns sentences on them.
    """
    drawn = [(stone.body, dict(losses))]
    names = [*stone.priors, *errors]
    remarks = []
    for numbers in _normal(len(names), samples):
        of = dict(zip(names, numbers, strict=True))
        sizes = {
            name: prior.value + prior.error * of[name]
            for name, prior in stone.priors.items()
        }
        own = {
            # A loss below zero is none.
            name: max(0.0, value + errors.get(name, 0.0) * of.get(name, 0.0))
            for name, value in losses.items()
        }
        try:
            body = stone.body
            if sizes:
                body = stone.remade(sizes)
            drawn.append((body, own))
        except ConfigError as error:
            remarks.append(one_line(str(error), 200))
    lost = len(remarks)
    if lost:
        remarks = [
            f"{lost} of {samples} samples are no stones, for example: {remarks[0]}"
        ]
    return drawn, remarks


def _normal(dimensions: int, samples: int) -> Iterator[list[float]]:
    """Yield points of a standard normal distribution, spread evenly."""
    if not dimensions:
        return
    # SciPy's statistics take longer to import than all the rest.
    from scipy.special import ndtri
    from scipy.stats import qmc

    power = (samples - 1).bit_length()
    points = qmc.Sobol(dimensions, rng=np.random.default_rng(0)).random_base2(power)
    yield from ndtri(points[:samples]).tolist()


def _integrated(rows: pd.DataFrame, tol: float) -> pd.DataFrame:
    """Return the runs of launched bodies to their horizons, with their unit of time.

    Of a run that failed, `status` says why, and the other columns say what came before.
    """
    import pandas as pd

    from rattlesweep.api.single import simulate

    runs = simulate(rows, record="reversals", tol=tol, progress=False)
    unit = np.sqrt(runs["height_m"] / runs["gravity_m_s2"])
    failed = runs.index[runs["status"] != "ok"]
    if len(failed):
        shorter = rows.loc[failed]
        shorter["t_end_s"] = EARLIER * runs["t_end"][failed] * unit[failed]
        again = simulate(shorter, record="reversals", tol=tol, progress=False)
        again["status"] = runs["status"][failed]
        runs = pd.concat([runs.drop(index=failed), again]).sort_index()
    return runs.assign(unit_s=unit)
