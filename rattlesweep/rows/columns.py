"""The columns of the table `runs` (a row per run): names, units, meanings and sources.

Columns come in groups, which a sweep has or lacks as a whole.  A column's source is a
function of the results of a block of runs.  The names are fixed, so that scripts
written against today's tables read next year's.
"""

from collections.abc import Collection, Iterable

import pyarrow as pa

from rattlesweep.rows.arrow import _SERIES, F64, FLAG, I32, I64, TEXT
from rattlesweep.rows.groups import (
    Column,
    Group,
    must,
    of_extremes,
    of_loss,
    of_mark,
    of_surface,
    on_request,
)
from rattlesweep.words.errors import ConfigError
from rattlesweep.words.names import REGIMES
from rattlesweep.words.quantities import (
    ACTING,
    CONSTANT_OF_SURFACE,
    DRIVES,
    ENERGY,
    LOSSES,
    MEASURES,
    QUANTITIES,
    RATE,
    TIME,
    Definition,
)
from rattlesweep.words.watched import EXTREME_WORDS, MARK_QUANTITIES

# When there is no rate of growth: "rolling > 0 or ...", for all losses that are no
# linear function of the angular velocity.
NOT_LINEAR = " or ".join(
    f"{each.name} > 0" for each in ACTING.values() if not each.is_linear
)

# What is told of a run beside the constant, for constants that some sweeps lack.
WITH_LOSS = {
    "pivot": (
        Column(
            "t_held",
            F64,
            lambda runs: runs.integrated.t_held,
            TIME,
            "first time at which the spin is held at zero; null: never",
            refines=True,
        ),
        Column(
            "held_time",
            F64,
            lambda runs: runs.integrated.held_time,
            TIME,
            "time for which the spin is held at zero",
            refines=True,
        ),
        Column(
            "pivot_work",
            F64,
            lambda runs: runs.integrated.pivot_work,
            meaning="energy lost by pivoting over the initial energy",
            refines=True,
        ),
    ),
    "creep": (
        Column(
            "creep_work",
            F64,
            lambda runs: runs.creep_work,
            meaning="energy lost by creep of the contact over the initial energy",
            refines=True,
        ),
        Column(
            "creep_doubtful",
            F64,
            lambda runs: runs.creep_doubtful,
            meaning="share of creep_work where the force exceeds 0.28 creep F_n or the "
            "body rolls faster than 2 |n| / creep, so that the law is in doubt",
            note="null: no creep, or the reduced model",
        ),
        Column(
            "K_p_creep",
            F64,
            lambda runs: runs.K_p_creep,
            meaning="K_p less what creep takes",
            note="null: no creep",
        ),
        Column(
            "K_r_creep",
            F64,
            lambda runs: runs.K_r_creep,
            meaning="K_r less what creep takes; if it has another sign than K_r, no "
            "steady spin reverses",
            note="null: no creep",
        ),
    ),
    "viscous": (
        Column(
            "slip_work",
            F64,
            lambda runs: runs.slip_work,
            meaning="energy lost by slip of the foot over the initial energy",
            refines=True,
        ),
        Column(
            "n_p",
            F64,
            lambda runs: runs.n_p,
            RATE,
            "spin above which the pitch grows, gamma_p / K_p",
            note="null: no slip, or K_p is 0",
        ),
        Column(
            "n_r",
            F64,
            lambda runs: runs.n_r,
            RATE,
            "the roll grows at spins below -n_r, gamma_r / K_r; spins from -n_r to n_p "
            "last",
            note="null: no slip, or K_r is 0",
        ),
    ),
    "mu": (
        Column(
            "t_slide",
            F64,
            lambda runs: runs.integrated.t_slide,
            TIME,
            "begin of the first slide; null: never",
            refines=True,
        ),
        must(
            "n_slides",
            I32,
            lambda runs: runs.integrated.n_slides,
            meaning="number of slides",
            refines=True,
        ),
        Column(
            "slide_time",
            F64,
            lambda runs: runs.integrated.slide_time,
            TIME,
            "time spent sliding",
            refines=True,
        ),
        Column(
            "slide_work",
            F64,
            lambda runs: runs.integrated.slide_work,
            meaning="energy lost by sliding over the initial energy",
            refines=True,
        ),
    ),
}

# The columns of `runs` in order.
GROUPS = (
    Group(
        "keys",
        "Keys",
        (
            must(
                "case",
                I32,
                lambda runs: runs.launches.case,
                meaning="number of the case, from 0",
            ),
            must(
                "sample",
                I64,
                lambda runs: runs.launches.sample,
                meaning="number of the run within its case, from 0",
            ),
        ),
    ),
    Group(
        "body",
        "Body and launch",
        (
            must("alpha", F64, lambda runs: runs.launches.bodies.alpha),
            must("beta", F64, lambda runs: runs.launches.bodies.beta),
            must("gamma", F64, lambda runs: runs.launches.bodies.gamma),
            must("theta", F64, lambda runs: runs.launches.bodies.theta),
            must("phi", F64, lambda runs: runs.launches.bodies.phi),
            must("xi", F64, lambda runs: runs.launches.bodies.xi),
            Column(
                "f_sd",
                F64,
                lambda runs: runs.launches.bodies.f_sd,
                note="null unless the source has it",
            ),
        ),
    ),
    Group(
        "launch",
        "Body and launch",
        (
            must(
                "n_i",
                F64,
                lambda runs: runs.launches.n_i,
                note="positive: unsteady direction if xi < 0",
            ),
            must("omega_xy0", F64, lambda runs: runs.launches.omega_xy0),
            Column("psi", F64, lambda runs: runs.launches.psi),
        ),
    ),
    Group(
        "theory",
        "Theory",
        (
            Column("omega_p", F64, lambda runs: runs.launches.modes.omega_p),
            Column("omega_r", F64, lambda runs: runs.launches.modes.omega_r),
            Column("K_p", F64, lambda runs: runs.launches.modes.K_p),
            Column("K_r", F64, lambda runs: runs.launches.modes.K_r),
            Column("n_c1", F64, lambda runs: runs.launches.n_c1, note="null: none"),
            Column("n_0", F64, lambda runs: runs.launches.n_0),
            Column(
                "t_rgh", F64, lambda runs: runs.launches.gh.t_rgh, note="null: none"
            ),
        ),
    ),
    Group(
        "result",
        "Result",
        (
            must("t_end", F64, lambda runs: runs.outcome.t_end, refines=True),
            Column(
                "t_r",
                F64,
                lambda runs: runs.outcome.t_r,
                note="null: none, or the body is dead",
                refines=True,
            ),
            Column(
                "type",
                TEXT,
                lambda runs: runs.type,
                meaning="R, SS, SW, unclassified or D; null if status is not ok",
                refines=True,
            ),
            must(
                "status",
                TEXT,
                lambda runs: runs.status,
                meaning="ok, or a word for what went wrong",
            ),
            Column(
                "n_end",
                F64,
                lambda runs: runs.n_end,
                RATE,
                "spin at t_end; if classify.early ended the run, its limit",
                refines=True,
            ),
            must(
                "n_steps",
                I64,
                lambda runs: runs.outcome.n_steps,
                meaning="accepted steps of the integrator",
                refines=True,
            ),
            Column(
                "energy_drift",
                F64,
                lambda runs: runs.outcome.energy_drift,
                meaning="relative change of energy at t_end",
                refines=True,
            ),
        ),
    ),
    Group(
        "observation",
        "Result",
        (
            Column(
                "amp_growth",
                F64,
                lambda runs: runs.outcome.amp_growth,
                meaning="largest growth of amplitude at ends of steps, between windows"
                "; 99 of 100 runs are within 6 % of that at all times",
                refines=True,
            ),
            Column(
                "n_departure",
                F64,
                lambda runs: runs.outcome.n_departure,
                meaning="largest fractional loss of spin at ends of steps, 1 - n/n_i"
                "; up to 0.0004 below that at all times",
                refines=True,
            ),
            must(
                "near_tangencies",
                I32,
                lambda runs: runs.outcome.near_tangencies,
                meaning="extrema so near zero that the spin may cross it",
            ),
        ),
    ),
    *(
        Group(
            surface,
            f"`bodies: {{surface: {surface}}}`",
            (of_surface(name),),
            optional=True,
        )
        for surface, name in CONSTANT_OF_SURFACE.items()
        if name is not None
    ),
    Group(
        "dissipation",
        "`dissipation`",
        (
            *(of_loss(name) for name, loss in LOSSES.items() if not loss.optional),
            Column(
                "growth",
                F64,
                lambda runs: runs.growth,
                RATE,
                f"growth rate of the oscillation at n_i; null if {NOT_LINEAR}",
            ),
            Column(
                "n_growth",
                F64,
                lambda runs: runs.n_growth,
                RATE,
                f"spin at which growth balances damping; null if {NOT_LINEAR}",
            ),
            Column(
                "energy_left",
                F64,
                lambda runs: runs.energy_left,
                meaning="fraction of the initial energy left at t_end",
            ),
        ),
        optional=True,
        not_with=("gh",),
    ),
    *(
        Group(
            name,
            f"`dissipation: {{{name}: ...}}`",
            (of_loss(name), *WITH_LOSS.get(name, ())),
            optional=True,
            # The reduced model has no contact force, and no foot slides.
            not_with=("gh",) if loss.takes_spin else ("reduced", "gh"),
        )
        for name, loss in LOSSES.items()
        if loss.optional
    ),
    Group(
        "base",
        "`base`",
        (
            *(of_loss(name) for name in DRIVES if name != "base_azimuth"),
            Column(
                "base_work",
                F64,
                lambda runs: runs.base_work,
                meaning="work of the plane that shakes over the initial energy",
                refines=True,
            ),
        ),
        optional=True,
        not_with=("reduced", "gh"),
    ),
    Group(
        "base_azimuth",
        "`base: {direction: horizontal, ...}`",
        (of_loss("base_azimuth"),),
        optional=True,
        not_with=("reduced", "gh"),
    ),
    # By the words of `record`.  They are null for a run that failed at launch.
    on_request(
        "energy",
        "`record: [energy]`",
        (
            Column(
                "energy_0",
                F64,
                lambda runs: runs.integrated.energy_0,
                ENERGY,
                "energy at launch",
            ),
            Column(
                "energy_drift_max",
                F64,
                lambda runs: runs.integrated.energy_drift_max,
                meaning="largest relative change of energy at ends of steps"
                "; at most 1 % below that at all times",
            ),
        ),
        not_with=("gh",),
    ),
    *map(of_extremes, EXTREME_WORDS),
    on_request(
        "windows",
        "`record: [windows]`",
        (
            Column(
                "window_t", F64, lambda runs: runs.window, TIME, "length of one window"
            ),
            Column(
                "window_amplitude",
                _SERIES,
                lambda runs: runs.window_amplitude,
                RATE,
                "largest amplitude of the relevant mode at ends of steps, by window"
                "; 99 of 100 are within 3 % of that at all times",
            ),
            Column(
                "window_n_min",
                _SERIES,
                lambda runs: runs.window_n_min,
                RATE,
                "smallest spin at ends of steps, by window"
                "; 99 of 100 are within 0.013 n_i of that at all times",
            ),
            Column(
                "window_n_max",
                _SERIES,
                lambda runs: runs.window_n_max,
                RATE,
                "largest spin at ends of steps, by window"
                "; 99 of 100 are within 0.003 n_i of that at all times",
            ),
        ),
        not_with=("gh",),
    ),
    on_request(
        "lyapunov",
        "`record: [lyapunov]`",
        (
            Column(
                "lyapunov",
                F64,
                lambda runs: runs.lyapunov,
                RATE,
                "largest Lyapunov exponent over the whole run, or up to t_r",
                refines=True,
            ),
            Column(
                "lyapunov_late",
                F64,
                lambda runs: runs.lyapunov_late,
                RATE,
                "the same from half time; null: too short",
            ),
        ),
        not_with=("reduced", "gh"),
    ),
    on_request(
        "spectrum",
        "`record: [spectrum]`",
        (
            Column(
                "lyapunov_spectrum",
                _SERIES,
                lambda runs: runs.lyapunov_spectrum,
                RATE,
                "the five Lyapunov exponents, descending; null: no motion",
            ),
            Column(
                "lyapunov_spectrum_late",
                _SERIES,
                lambda runs: runs.lyapunov_spectrum_late,
                RATE,
                "the same from half time; null: too short",
            ),
            Column(
                "kaplan_yorke",
                F64,
                lambda runs: runs.kaplan_yorke,
                meaning="dimension of Kaplan and Yorke at constant energy, late",
                refines=True,
            ),
            Column(
                "regime",
                TEXT,
                lambda runs: runs.regime,
                meaning=f"{', '.join(REGIMES)}; null: unknown",
                refines=True,
            ),
        ),
        not_with=("reduced", "gh"),
    ),
    Group(
        "chaos",
        "`record: [lyapunov]` or `[spectrum]`",
        (
            Column(
                "chaotic",
                FLAG,
                lambda runs: runs.chaotic,
                meaning="largest late exponent * t_end / 2 > 10; null: run too short",
            ),
        ),
        optional=True,
        not_with=("reduced", "gh"),
    ),
    on_request(
        "volume",
        "`record: [volume]`",
        (
            Column(
                "volume_rate",
                F64,
                lambda runs: runs.integrated.volume_rate,
                RATE,
                "mean rate of the logarithm of phase volume over the run",
            ),
        ),
        not_with=("reduced", "gh"),
    ),
    *map(of_mark, MARK_QUANTITIES),
    on_request(
        "late",
        "`record: [late]`",
        (
            Column(
                "n_late_mean",
                F64,
                lambda runs: runs.integrated.late[:, 0, 0],
                RATE,
                "mean spin over the last quarter of the run",
                "null: the run ended before its horizon",
                refines=True,
            ),
            Column(
                "n_late_std",
                F64,
                lambda runs: runs.integrated.late[:, 0, 1],
                RATE,
                "standard deviation of the spin over that time",
                "null: the run ended before its horizon",
                refines=True,
            ),
        ),
        not_with=("gh",),
    ),
    on_request(
        "casimir",
        "`record: [casimir]`",
        (
            Column(
                "casimir_min",
                F64,
                lambda runs: runs.casimir_min,
                meaning="least Casimir invariant ln(E_p)/K_p + ln(E_r)/K_r, of "
                "energies averaged over a period of the roll",
                note="null: an energy is zero",
            ),
            Column(
                "casimir_max",
                F64,
                lambda runs: runs.casimir_max,
                meaning="its largest value",
                note="null: an energy is zero",
            ),
        ),
        not_with=("gh",),
    ),
    Group(
        "casimir_turns",
        "`record: [casimir, reversals]`",
        (
            Column(
                "casimir_jumps",
                _SERIES,
                lambda runs: runs.casimir_jumps,
                meaning="change of the mean Casimir invariant at each of the first "
                "eight turns, from the time since the last turn to that until the next",
            ),
        ),
        optional=True,
        not_with=("gh",),
    ),
    on_request(
        "error",
        "`record: [error]`",
        (
            Column(
                "t_r_error",
                F64,
                lambda runs: runs.estimated.t_r_error,
                TIME,
                "estimated bound of the error of t_r; null: no t_r",
            ),
            Column(
                "type_sure",
                FLAG,
                lambda runs: runs.type_sure,
                meaning="whether the type is the same within the errors",
            ),
            Column(
                "amp_growth_error",
                F64,
                lambda runs: runs.estimated.amp_growth_error,
                meaning="estimated error of amp_growth; null: unknown",
            ),
            Column(
                "n_departure_error",
                F64,
                lambda runs: runs.estimated.n_departure_error,
                meaning="estimated error of n_departure; null: unknown",
            ),
        ),
        not_with=("gh",),
    ),
    Group(
        "tol",
        "`integrator: {accuracy: {t_r: ...}}`",
        (
            Column(
                "tol",
                F64,
                lambda runs: runs.estimated.tol,
                meaning="tolerance at which the run was integrated",
            ),
        ),
        optional=True,
        not_with=("gh",),
    ),
    on_request(
        "reversals",
        "`record: [reversals]`",
        (
            Column(
                "n_turns",
                I32,
                lambda runs: runs.n_turns,
                meaning="turns, from a spin beyond n_i/4 to beyond -n_i/4",
                formula="number of turns",
                refines=True,
            ),
            Column(
                "turn_times",
                _SERIES,
                lambda runs: runs.turn_times,
                TIME,
                "first zero in each of the first eight turns",
            ),
            Column(
                "spin_after_turn",
                _SERIES,
                lambda runs: runs.spin_after_turn,
                RATE,
                "largest absolute spin until the next turn",
            ),
        ),
        not_with=("gh",),
    ),
    Group(
        "turns",
        "`record: [reversals, error]`",
        (
            Column(
                "reversals_sure",
                I32,
                lambda runs: runs.reversals_sure,
                meaning="first turns with an error below 1e-3; at most eight",
                formula="number of confirmed turns",
            ),
            Column(
                "reversal_times_error",
                _SERIES,
                lambda runs: runs.reversal_times_error,
                TIME,
                "estimated error of turn_times; null: unknown",
            ),
        ),
        optional=True,
        not_with=("gh",),
    ),
)

# Further columns of `runs` launched from a full state, and of bodies with a known size.
STATE_GROUP = Group(
    "state",
    "Launches from a full state",
    (
        must("omega_x", F64, lambda runs: runs.state.omega_x),
        must("omega_y", F64, lambda runs: runs.state.omega_y),
        must("omega_z", F64, lambda runs: runs.state.omega_z),
        must("u_x", F64, lambda runs: runs.state.u_x),
        must("u_y", F64, lambda runs: runs.state.u_y),
        must("u_z", F64, lambda runs: runs.state.u_z),
    ),
)
SIZE_GROUP = Group(
    "size",
    "Bodies in SI units",
    (
        Column("t_r_s", F64, lambda runs: runs.t_r_s, "s", "t_r in seconds"),
        must(
            "n_i_rpm",
            F64,
            lambda runs: runs.n_i_rpm,
            "rpm",
            "n_i in turns a minute, counterclockwise from above",
        ),
    ),
)

COLUMNS: dict[str, Column] = {
    column.name: column
    for group in (*GROUPS, STATE_GROUP, SIZE_GROUP)
    for column in group.columns
}
"""All columns of `runs` that rattlesweep computes, by name."""

RUN_FIELDS: dict[str, tuple[pa.Field, ...]] = {
    group.name: tuple(column.field for column in group.columns) for group in GROUPS
}
STATE_FIELDS = tuple(column.field for column in STATE_GROUP.columns)
# Of bodies with a known size.
MEASURED = tuple(column.field for column in SIZE_GROUP.columns)
# Optional groups of columns, with the models that do not have them.
RECORD_PARTS: dict[str, tuple[str, ...]] = {
    group.name: group.not_with for group in GROUPS if group.optional
}


def define(name: str) -> Definition:
    """Return the definition of a quantity or of a column, by its name.

    A name that is neither, such as a user's own column, is its own symbol and meaning.
    A column in SI units, such as ``n_i_rpm``, has the symbol of its quantity.
    """
    if name in MEASURES and name not in QUANTITIES:
        definition, measure = MEASURES[name]
        return Definition(
            name, measure.unit, definition.meaning, formula=definition.symbol
        )
    if name in QUANTITIES:
        return QUANTITIES[name]
    if name in COLUMNS:
        return COLUMNS[name].definition
    return Definition(name, "1", name)


def runs_schema(
    record: Collection[str] = (), model: str = "full", extra: Iterable[pa.Field] = ()
) -> pa.Schema:
    """Return the schema of `runs` with optional groups, by name, and `extra` columns.

    Raises a ConfigError if the model does not have one of the groups.
    """
    refused = sorted(name for name in record if model in RECORD_PARTS[name])
    if refused:
        raise ConfigError(f"record: the model {model!r} cannot record {refused[0]!r}")
    fields: list[pa.Field] = []
    for group in GROUPS:
        if not group.optional or group.name in record:
            fields += RUN_FIELDS[group.name]
    return pa.schema([*fields, *extra])
