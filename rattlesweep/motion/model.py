"""Models: a chart, a surface and actions, composed to equations of motion."""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cache, cached_property
from math import sqrt

import numpy as np

from rattlesweep.arrays import Floats
from rattlesweep.motion.action import (
    ACTIONS,
    ROLLING,
    VISCOUS,
    Action,
    numbered,
)
from rattlesweep.motion.chart import ANYWHERE, SLOPES, Chart
from rattlesweep.motion.equations import (
    at_contact,
    contact_force_of,
    drift_of,
    energy_less_work,
    equations_of,
    error_of,
    on_surface,
    pivot_of,
    rise_of,
    volume_of,
)
from rattlesweep.motion.fast import fast_for
from rattlesweep.motion.slides import Slide, slide_of
from rattlesweep.motion.slipping import (
    rates_of_place,
    stiffness_of,
    velocity_of,
)
from rattlesweep.motion.sums import (
    Numbering,
)
from rattlesweep.motion.track import UNSEEN, track_of
from rattlesweep.physics import frame, full, reduced, stone, tangent, vectors
from rattlesweep.physics.full import TINY, scalar
from rattlesweep.physics.surface import (
    ELLIPSOID,
    PARABOLOID,
    SURFACES,
    Formula,
    Surface,
)


@dataclass(frozen=True, eq=False)
class Model:
    """Equations of motion and observed quantities, as compiled functions of numbers.

    The formulas take tuples of numbers: the state ``y``, its derivative ``dy`` and the
    ``constants`` of the body.  What a model does not have is None.
    """

    name: str  # by which :func:`find_model` composes it
    components: tuple[str, ...]  # names of the components of the state
    constants: tuple[str, ...]  # their names
    # Numbers in a ``probe``, which tells the relevant mode: for bodies its left
    # eigenvector, first the real part.
    n_probe: int
    rhs: Formula  # rhs(y, constants): dy
    spin: Formula  # spin(y)
    spin_rate: Formula  # spin_rate(y, dy)
    # amplitude(y, probe): square of the amplitude of the relevant oscillation
    amplitude: Formula
    # error(e, y, constants): two squares that a step control compares: that of the
    # error e of a step, and that of the oscillation
    error: Formula
    # energy(y, constants): conserved; where something acts, the energy minus its work
    energy: Formula
    # force(y, dy, constants): normal force, then the square of the tangential force
    force: Formula
    work: Formula  # work(y): work of the actions since the launch
    # mode_energies(y, constants): energies of pitch and roll, weights in proportion to
    # 1/K_p and 1/K_r, and the period over which they are to be averaged, or 0
    mode_energies: Formula

    # Where a run ends or changes.
    # limit(y, constants): positive where the model holds; a run ends where it is zero
    limit: Formula | None = None
    # rise(y, constants): height of the contact over the lowest point of the body, along
    # its z axis; None for models without a contact point
    rise: Formula | None = None
    lifts: bool = False  # whether a body may leave the plane, where its run ends
    slide: Slide | None = None  # None: the plane holds the body whatever the force

    # What the model is composed of.
    chart: Chart | None = None
    surface: Surface | None = None
    actions: tuple[Action, ...] = ()
    # Of an action that pivots.  pivot(y, constants): the torque along the vertical, the
    # normal force that bounds the torque of a held spin, and the normal force.
    # pivot_work(y): its work, negative.
    pivot: Formula | None = None
    pivot_work: Formula | None = None
    volume: Formula | None = None  # volume(y, constants): rate of phase volume
    # Number of components, the last ones, that the state of a sweep lacks.
    n_extra: int = 0

    # Of an action that slips, for implicit steps.  slip(y): the velocity of the contact
    # point along h_1 and h_2.  stiffness(y, constants): as in `physics.friction.slip`.
    # moving(y, constants): rates of the position.
    slip: Formula | None = None
    stiffness: Formula | None = None
    moving: Formula | None = None

    # Functions x of the state that are cheaper to integrate beside it than to compute
    # in each stage.  carried_start(y, constants): x at the start of a step.
    # carried_rhs(y, x, constants): dy and dx.
    n_carried: int = 0
    carried_start: Formula | None = None
    carried_rhs: Formula | None = None

    # For runs with tangents, small differences, whose components follow each other in
    # ``v``.  rate(y, dy, v, constants): dv.  seed(y, constants): the first v.
    # transverse(y, dy, v, constants): the part that is measured.
    n_tangents: int = 0
    rate: Formula | None = None
    seed: Formula | None = None
    transverse: Formula | None = None
    square: Formula | None = None  # square(v, constants): |v|^2 of one tangent
    # Of a frame of several tangents: factor(v, constants): the triangle R of its
    # factors QR.  solve(v, R): the tangents Q.  trivial(y, dy, constants): squared
    # norms of the flow and of the gradient of the energy.
    factor: Formula | None = None
    solve: Formula | None = None
    trivial: Formula | None = None

    # The values of constants that users do not give.
    fixed: dict[str, float] = field(default_factory=dict)
    # Of the reduced model with losses: constants without all of which nothing is lost.
    strengths: tuple[str, ...] = ()

    @cached_property
    def contact(self) -> Formula:
        """The formula ``contact(y, constants)``: normal and tangential force."""
        rhs = self.rhs
        force = self.force

        @scalar
        def contact(y, constants):
            normal, square = force(y, rhs(y, constants), constants)
            return normal, sqrt(square)

        formula: Formula = contact
        return formula

    @property
    def layout(self) -> Numbering:
        """Where the numbers of actions are."""
        return Numbering(self.components, self.constants)

    @property
    def n_state(self) -> int:
        """The number of components of the state."""
        return len(self.components)

    @property
    def n_constants(self) -> int:
        """The number of ``constants``."""
        return len(self.constants)

    @property
    def of_runs(self) -> tuple[str, ...]:
        """The names of all constants of a run: the body's, and what slides need."""
        if self.slide is None:
            return self.constants
        return *self.constants, "mu"

    def named(self, values: Floats) -> dict[str, Floats]:
        """Return constants of runs, one in each row of `values`, by their names."""
        return dict(zip(self.of_runs, values, strict=True))

    def column(self, component: str) -> int:
        """Return the place of a component of the state."""
        return self.components.index(component)

    def at_launch(self, place: Floats, values: Mapping[str, Floats]) -> Floats:
        """Return states at launch, a row each, from their first components.

        `values` are the constants of the runs by name.
        """
        y0 = np.zeros((len(place), self.n_state))
        y0[:, : place.shape[1]] = place
        for action in self.actions:
            if action.start is not None:
                starts = action.start(place, values)
                for name, start in zip(action.components, starts, strict=True):
                    y0[:, self.column(name)] = start
        return y0

    # The same body in other models

    @property
    def vanishing(self) -> tuple[str, ...]:
        """The constants that another model lacks, for bodies with zero for them."""
        if self.chart is not SLOPES:
            return self.strengths
        names = [each.strength for each in self.actions if each is not VISCOUS]
        if self.surface is not PARABOLOID:
            names.append("k")
        return tuple(names)

    def without(self, names: Collection[str]) -> Model:
        """Return the model of bodies that have zero for some constants of a model."""
        if self.strengths:
            given = [name for name in self.strengths if name not in names]
            if "lever" in given:
                given = ["pivot"]
            return reduced_model(given)
        assert self.chart is not None
        assert self.surface is not None
        left = [each for each in self.actions if each.strength not in names]
        on = PARABOLOID if "k" in names else self.surface
        return compose(self.chart, on, left, slides=self.slide is not None)

    @property
    def anywhere(self) -> Model | None:
        """The model in variables that exist in any position, where they can be left."""
        if self.chart is not SLOPES or self.surface is None or not self.surface.closed:
            return None
        slides = self.slide is not None
        return compose(ANYWHERE, self.surface, self.actions, slides=slides)

    @property
    def with_attitude(self) -> Model:
        """The model that adds the attitude, for single steps."""
        return find_model(f"{self.name}{ATTITUDE}")


ATTITUDE = "_attitude"
SLIDING = "_sliding"
TANGENTS = {"_tangent": 1, "_frame": frame.N_TANGENTS}


@scalar
def no_work(y):
    """Return the work where nothing acts."""
    return 0.0


def _picked(component: int) -> Formula:
    """Return a component of the state as a formula."""

    @scalar
    def picked(y):
        return y[component]

    return picked  # type: ignore[no-any-return]


def compose(
    chart: Chart,
    surface: Surface,
    actions: Iterable[Action] = (),
    *,
    slides: bool = False,
    tangents: int = 0,
) -> Model:
    """Return the model of bodies on a surface under actions, in a chart.

    With `slides` they slide where friction cannot hold them.  In any position all sets
    have the viscous torque and the rolling resistance, so that they share kernels.
    `tangents` are those of the full model: none, one, or a frame.
    """
    acting = numbered(actions)
    if chart is ANYWHERE:
        acting = numbered([VISCOUS, ROLLING, *acting])
    return _composed(chart, surface, acting, slides, tangents)


def name_of(
    chart: Chart, surface: Surface, actions: Collection[Action], slides: bool
) -> str:
    """Return the name of a composition, from which `find_model` composes it."""
    name = surface.model
    implied = []
    if len(actions) > 1:
        implied = [VISCOUS]
    if chart is ANYWHERE:
        name = chart.name
        implied = [VISCOUS, ROLLING]
    words = [name, *(each.name for each in actions if each not in implied)]
    return "_".join(words) + (SLIDING if slides else "")


def find_model(name: str) -> Model:
    """Return the model of a name: ``ellipsoid_rolling_sliding``, ``reduced``, ...

    Raises KeyError if there is none.
    """
    return MODELS.get(name) or _named(name)


@cache
def _named(name: str) -> Model:
    """Return the composition of a name: surface or chart, actions, and what follows."""
    if name.endswith(ATTITUDE):
        return with_attitude(find_model(name.removesuffix(ATTITUDE)))
    for ending, count in TANGENTS.items():
        if name == f"{PARABOLOID.model}{ending}":
            return compose(SLOPES, PARABOLOID, tangents=count)
    first, *words = name.removesuffix(SLIDING).split("_")
    chart = ANYWHERE if first == ANYWHERE.name else SLOPES
    on = {each.model: each for each in SURFACES.values()} | {ANYWHERE.name: ELLIPSOID}
    actions = [ACTIONS[word] for word in words]
    return compose(chart, on[first], actions, slides=name.endswith(SLIDING))


@cache
def _composed(
    chart: Chart,
    surface: Surface,
    actions: tuple[Action, ...],
    slides: bool,
    tangents: int,
) -> Model:
    constants = _constants(chart, surface, actions)
    components = _components(chart, actions)
    layout = Numbering(components, constants)
    fast = fast_for(chart, actions)
    contact = surface.contact if chart is SLOPES else vectors.contact_under
    rhs_on, parts_on = equations_of(chart, actions, layout, fast)
    n_place = len(chart.place)

    model = Model(
        name_of(chart, surface, actions, slides),
        components,
        constants,
        n_probe=8,
        rhs=on_surface(rhs_on, contact),
        spin=chart.spin,
        spin_rate=chart.spin_rate,
        amplitude=chart.amplitude,
        error=error_of(chart, actions, layout),
        energy=energy_less_work(chart, surface, contact, actions, layout),
        force=contact_force_of(chart, surface, contact, actions, layout),
        work=_picked(n_place) if actions else no_work,
        mode_energies=chart.mode_energies,
        rise=rise_of(chart, contact),
        lifts=any(each.lifts for each in actions),
        chart=chart,
        surface=surface,
        actions=actions,
        fixed={name: x for each in actions for name, x in each.fixed.items()},
    )
    if fast is not None and fast.volume is not None:
        model = replace(model, volume=volume_of(chart, fast.volume))
    for action in actions:
        if not action.pivots:
            continue
        assert action.own_work is not None
        assert parts_on is not None
        model = replace(
            model,
            pivot=pivot_of(parts_on, contact, drifts=drift_of(actions) is not None),
            pivot_work=_picked(layout.components.index(action.own_work)),
        )
    for action in actions:
        if not action.slips:
            continue
        model = replace(
            model,
            slip=velocity_of(action, layout),
            stiffness=at_contact(stiffness_of(chart, action, layout), contact),
            moving=at_contact(rates_of_place(chart), contact),
        )
    if slides:
        slide = slide_of(chart, contact, actions, layout)
        if model.anywhere is not None:
            slide = replace(slide, steepest=chart.steepest)
        model = replace(model, slide=slide)
    # Steps that are implicit carry nothing.
    if surface.carried is not None and chart is SLOPES and model.stiffness is None:
        model = _with_carried(model, surface, rhs_on)
    if tangents:
        model = _with_tangents(model, tangents)
    return model


def _constants(
    chart: Chart, surface: Surface, actions: Collection[Action]
) -> tuple[str, ...]:
    """Return the names of the constants of a model."""
    of_body: tuple[str, ...] = stone.CONSTANTS
    if surface is PARABOLOID and not actions:
        of_body = full.CONSTANTS
    return *of_body, *(name for each in actions for name in each.constants)


def _components(chart: Chart, actions: Collection[Action]) -> tuple[str, ...]:
    """Return the names of the components: place, works, those of actions."""
    works = []
    if actions:
        works = ["work"]
    # That of pivoting follows the work of all, as modes and fast equations have it.
    for action in sorted(actions, key=lambda each: not each.pivots):
        if action.own_work is not None:
            works.append(action.own_work)
    own = (name for each in actions for name in each.components)
    return *chart.place, *works, *own


def _with_carried(model: Model, surface: Surface, rhs: Formula) -> Model:
    """Return a model that carries a function of the slope beside the state."""
    assert surface.carried is not None
    start_at = surface.carried.start
    rate_at = surface.carried.rate
    contact = surface.carried.contact

    @scalar
    def start(y, constants):
        return (start_at(y, constants[3:7]),)

    @scalar
    def carried_rhs(y, x, constants):
        shape = constants[3:7] + x
        dy = rhs(contact, y, constants[:3], shape, constants[7:])
        return dy + (rate_at(y, dy, shape),)  # noqa: RUF005

    return replace(model, n_carried=1, carried_start=start, carried_rhs=carried_rhs)


# Attitude and path, for single steps


def with_attitude(plain: Model) -> Model:
    """Return a model with attitude and path."""
    assert plain.chart is not None
    assert plain.surface is not None
    n = plain.n_state
    track = track_of(plain.chart, plain.rhs, n, plain.surface.contact, plain.slip)
    slid = track.slid
    slide = plain.slide
    if slide is not None:
        plain_place = slide.place
        plain_derivative = slide.derivative

        @scalar
        def place(y, slip, mu, constants):
            return plain_place(y[:n], slip, mu, constants)

        @scalar
        def derivative(y, slip, placed, omega_rate, normal, constants):
            f = plain_derivative(y[:n], slip, placed, omega_rate, normal, constants)
            return f + slid(y, slip, placed)

        slide = replace(slide, place=place, derivative=derivative)
    return replace(
        plain,
        name=f"{plain.name}{ATTITUDE}",
        components=(*plain.components, *track.names),
        n_probe=0,
        n_extra=len(track.names),
        n_carried=0,
        rhs=track.rhs,
        slide=slide,
        **UNSEEN,  # type: ignore[arg-type]
    )


# Small differences between two runs, for Lyapunov exponents


def _with_tangents(model: Model, count: int) -> Model:
    """Return the full model with one tangent or a frame."""
    if count == 1:
        return replace(
            model,
            name=f"{model.name}_tangent",
            n_tangents=1,
            rate=tangent.rate,
            seed=tangent.seed,
            transverse=tangent.transverse,
            square=tangent.square,
        )
    return replace(
        model,
        name=f"{model.name}_frame",
        n_tangents=frame.N_TANGENTS,
        rate=frame.rate,
        seed=frame.seed,
        transverse=frame.transverse,
        factor=frame.factor,
        solve=frame.solve,
        trivial=frame.trivial,
    )


# The reduced model


@scalar
def _reduced_spin(y):
    return y[0]


@scalar
def _reduced_spin_rate(y, dy):
    return dy[0]


@scalar
def _reduced_amplitude(y, probe):
    _, e_p, e_r = y[:3]
    w_p, w_r = probe
    return w_p * e_p + w_r * e_r


@scalar
def _no_force(y, dy, constants):
    return 1.0, 0.0


@scalar
def _reduced_error(e, y, constants):
    # Each energy is compared with itself: the decaying one determines what happens much
    # later.
    dn, de_p, de_r = e[:3]
    n, e_p, e_r = y[:3]
    inertia = constants[2]
    spin = inertia * dn * dn / (inertia * n * n + 2.0 * (e_p + e_r) + TINY)
    pitch = de_p * de_p / (e_p * e_p + TINY)
    roll = de_r * de_r / (e_r * e_r + TINY)
    return spin + pitch + roll, 1.0


REDUCED = Model(
    "reduced",
    ("n", "E_p", "E_r"),
    reduced.CONSTANTS,
    n_probe=2,
    rhs=reduced.rhs,
    spin=_reduced_spin,
    spin_rate=_reduced_spin_rate,
    amplitude=_reduced_amplitude,
    error=_reduced_error,
    energy=reduced.energy,
    force=_no_force,
    work=no_work,
    mode_energies=reduced.averaged_energies,
)
REDUCED_LOSSY = replace(
    REDUCED,
    name="reduced_lossy",
    components=(*REDUCED.components, "work", "slip work"),
    constants=reduced.LOSSY_CONSTANTS,
    rhs=reduced.lossy_rhs,
    energy=reduced.lossy_energy,
    work=_picked(reduced.N_STATE),
    strengths=reduced.STRENGTHS,
)
REDUCED_PIVOTING = replace(
    REDUCED_LOSSY,
    name="reduced_pivoting",
    components=(
        *REDUCED.components,
        *("work", "pivot work", "creep work", "slip work"),
    ),
    constants=reduced.PIVOTING_CONSTANTS,
    rhs=reduced.lossy_pivoting_rhs,
    pivot=reduced.pivot,
    pivot_work=_picked(reduced.N_STATE + 1),
    strengths=(*reduced.STRENGTHS, "lever"),
    fixed={"sense": 1.0},
)
MODELS: dict[str, Model] = {
    model.name: model for model in (REDUCED, REDUCED_LOSSY, REDUCED_PIVOTING)
}
"""Models that are no compositions, by name."""


def reduced_model(losses: Collection[str]) -> Model:
    """Return the reduced model of bodies with some constants of dissipation."""
    if "pivot" in losses:
        return REDUCED_PIVOTING
    return REDUCED_LOSSY if losses else REDUCED


FULL = compose(SLOPES, PARABOLOID)
FULL_ELLIPSOID = compose(SLOPES, ELLIPSOID)
