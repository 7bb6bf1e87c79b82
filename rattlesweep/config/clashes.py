"""Rules between the keys of a config."""

import math
from collections.abc import Collection, Container, Iterator

from rattlesweep.config.body_sources import (
    GridSource,
    MeshSource,
    PresetSource,
    SdSource,
    ShapeSource,
    Surfaced,
)
from rattlesweep.config.keys import FROM_TABLE, MAX_CASES, OF_SLIDES, Base
from rattlesweep.config.schema import Config
from rattlesweep.config.values import AT_REST
from rattlesweep.kernel.method.tableau import METHODS
from rattlesweep.words.errors import ConfigError
from rattlesweep.words.quantities import (
    ANGLES,
    CONSTANT_OF_SURFACE,
    LOSSES,
    QUANTITIES,
    SURFACE_CONSTANTS,
)
from rattlesweep.words.units import require_unit, with_article

Clash = tuple[str, str]  # dotted key and message
SETTING_KEYS = {
    "n_i": "spin.n_i",
    "omega_xy0": "spin.omega_xy0",
    "t_end": "horizon.t",
    **{name: f"dissipation.{name}" for name in LOSSES},
    "base_frequency": "base.frequency",
    "base_acceleration": "base.acceleration",
    "base_amplitude": "base.amplitude",
    "base_phase": "base.phase_deg",
    "base_azimuth": "base.azimuth_deg",
}
"""Keys that may have SI units, by the columns that they set."""


def clashes(config: Config) -> Iterator[Clash]:
    """Yield a dotted key and a message for each broken rule between keys.

    If the bodies are those of a table, :func:`clashes_of_actions` waits for its
    columns, which may say what acts.
    """
    yield from _body_clashes(config)
    yield from _empty_sections(config)
    yield from _choices_of_runs(config)
    yield from _launches(config)
    yield from _words(config)
    if config.bodies.source != FROM_TABLE:
        yield from _units(config)
        yield from clashes_of_actions(config)


def clashes_of_actions(config: Config) -> Iterator[Clash]:
    """Yield the broken rules on what acts on bodies, and on what goes with it."""
    yield from _dissipation(config)
    yield from _plane(config)
    yield from _integrator(config)
    yield from _records(config)


def _empty_sections(config: Config) -> Iterator[Clash]:
    sections: dict[str, Base | None] = {"stop": config.stop, "horizon": config.horizon}
    if isinstance(config.bodies, GridSource):
        sections["bodies.axes"] = config.bodies.axes
    for name, section in sections.items():
        if section is not None and not section.given:
            names = ", ".join(type(section).model_fields)
            yield name, f"no key is given; add one of {names}"


def _choices_of_runs(config: Config) -> Iterator[Clash]:
    bodies = config.bodies
    if config.stop is None:
        return
    if not getattr(bodies, "drawn", ()):
        yield "stop", f"source {bodies.source} draws no samples; take source: sd"
    if isinstance(bodies, SdSource) and bodies.draw == "saltelli":
        yield "stop", "draw: saltelli has groups of dependent samples; take draw: sobol"


def _launches(config: Config) -> Iterator[Clash]:
    spin = config.spin
    launch = config.launch
    if spin and launch:
        yield "spin", "spin and launch are both given; keep one of them"
    if not (spin or launch or config.bodies.source == FROM_TABLE):
        yield (
            "spin",
            "the key is missing; give n_i and omega_xy0, or a launch with omega and u",
        )
    if launch and not any((*launch.omega, *launch.u[:2])):
        yield "launch", AT_REST
    lengths = [len(values) for values in config.acting.values.values()]
    if spin:
        lengths += [len(spin.n_i), len(spin.omega_xy0)]
    if isinstance(config.bodies, SdSource) and config.bodies.target:
        lengths.append(len(config.bodies.target.values))
    if isinstance(config.bodies, MeshSource):
        lengths.append(len(config.bodies.path))
    cases = math.prod(lengths)
    if cases > MAX_CASES:
        yield "spin", f"the lists make {cases} cases; at most {MAX_CASES} are possible"


def _units(config: Config) -> Iterator[Clash]:
    """Refuse units, or their lack, before any body is drawn."""
    if config.bodies.has_size:
        yield from numbers_without_unit(config)
        return
    for name, values in config.settings.items():
        texts = [value.si.text for value in values if value.si is not None]
        if texts:
            yield (
                SETTING_KEYS[name],
                f"{texts[0]} needs bodies with a size; give a number without a unit, "
                "or take source: shape, the preset KL, or a table with height_m and "
                "mass_kg",
            )


def numbers_without_unit(config: Config) -> Iterator[Clash]:
    """Yield the numbers of a config that need a unit, as its bodies have a size."""
    for name, values in config.settings.items():
        kind = QUANTITIES[name].kind
        numbers = [value.natural for value in values if value.natural is not None]
        # The unit of some angles is in the name of their key.
        has_unit = SETTING_KEYS[name].endswith("_deg")
        try:
            if kind and not has_unit:
                require_unit(SETTING_KEYS[name], numbers, kind)
        except ConfigError as error:
            key, _, sentence = str(error).partition(": ")
            yield key, sentence


def _words(config: Config) -> Iterator[Clash]:
    """Refuse words in place of numbers where they stand for nothing."""
    losses = config.dissipation
    if config.bodies.source != FROM_TABLE:
        sections = {"dissipation": losses, "base": config.base}
        for name, section in sections.items():
            values = section.values if section else {}
            if any(FROM_TABLE in each for each in values.values()):
                yield name, "the word table needs source: table; give a number"
    if OF_SLIDES in losses.creep and (len(losses.creep) > 1 or not losses.slides):
        yield (
            "dissipation.creep",
            "the word mu stands for dissipation.mu; give that, and no further creep, "
            "or a number",
        )


def _dissipation(config: Config) -> Iterator[Clash]:
    losses = config.dissipation
    if config.horizon.t_decay and "sigma" not in losses.present:
        yield (
            "horizon.t_decay",
            "it is in units of gamma/sigma, and sigma is 0; give dissipation.sigma",
        )
    if losses.creeps and not losses.pivots:
        yield (
            "dissipation.creep",
            "the contact creeps only where it pivots; give dissipation.pivot, or leave "
            "creep out",
        )
    if losses.slips:
        yield from _slipping(config)
    if losses.slides:
        yield from _sliding(config)
    if losses and config.model == "gh":
        yield "dissipation", "the model gh conserves energy; take full or reduced"
    if losses.slides and config.model == "reduced":
        yield (
            "dissipation.mu",
            "the reduced model has no contact force, so no foot slides; take model: "
            "full, or leave mu out",
        )
    if config.model == "reduced":
        for name in losses.present:
            if LOSSES[name].takes_spin and not LOSSES[name].is_averaged:
                yield (
                    f"dissipation.{name}",
                    f"the reduced model has no average of {name} over swings; take "
                    f"model: full, or leave {name} out",
                )


def _slipping(config: Config) -> Iterator[Clash]:
    """Refuse what is not defined where the foot slips under viscous friction."""
    losses = config.dissipation
    for problem in clashes_of_slip(slides=losses.slides, pivots=losses.pivots):
        yield "dissipation.viscous", problem
    yield from _fixed_steps(config, "viscous slip", "dissipation.viscous")


def clashes_of_slip(*, slides: bool, pivots: bool) -> Iterator[str]:
    """Yield what is wrong with viscous friction beside mu or pivoting friction."""
    if slides:
        yield (
            "with viscous friction the foot slips under any force, so it has no limit "
            "mu; leave out viscous or mu"
        )
    if pivots:
        yield (
            "pivoting is that of a foot that holds, and with viscous friction it "
            "slips; leave out viscous or pivot"
        )


def refuse_slip_beside(losses: Container[str], name: str = "viscous") -> None:
    """Raise a ConfigError if friction is viscous, and of another kind as well.

    `losses` are the names of the constants that are not zero, and `name` is what the
    user calls the viscous one.
    """
    if "viscous" not in losses:
        return
    for problem in clashes_of_slip(slides="mu" in losses, pivots="pivot" in losses):
        raise ConfigError(f"{name}: {problem}")


def _fixed_steps(config: Config, motion: str, key: str) -> Iterator[Clash]:
    """Refuse a method of fixed steps for a motion that needs others."""
    method = config.integrator.method
    if not METHODS[method].adaptive:
        yield (
            "integrator.method",
            f"{method} cannot follow {motion}, whose steps must adapt; take dop853, or "
            f"leave {key} out",
        )


def _plane(config: Config) -> Iterator[Clash]:
    """Refuse a plane that is not described, or that no equations are for."""
    plane = config.base
    if plane is None:
        return
    given = [name for name, value in plane if value is not None]
    yield from clashes_of_plane(given, plane.is_horizontal)
    if config.model != "full":
        yield (
            "base",
            f"the plane of the model {config.model} is at rest; take model: full",
        )


def clashes_of_plane(given: Collection[str], is_horizontal: bool) -> Iterator[Clash]:
    """Yield the broken rules between the keys that are given of a plane."""
    if ("acceleration" in given) == ("amplitude" in given):
        yield "base.acceleration", "give acceleration or amplitude, and not both"
    if "azimuth_deg" in given and not is_horizontal:
        yield (
            "base.azimuth_deg",
            "a plane that shakes up and down has no azimuth; leave azimuth_deg out, or "
            "add direction: horizontal",
        )


def _sliding(config: Config) -> Iterator[Clash]:
    """Refuse what is not defined where the foot slides."""
    yield from _fixed_steps(config, "a slide", "dissipation.mu")
    if "volume" in config.record:
        yield (
            "record",
            "volume is not defined where the foot slides; leave it out, or "
            "dissipation.mu",
        )


def _integrator(config: Config) -> Iterator[Clash]:
    integrator = config.integrator
    method = integrator.method
    word = integrator.accuracy
    if not METHODS[method].adaptive:
        control = "dt"
    elif word:
        control = "accuracy"
    else:
        control = "tol"
    reason = f"{method} takes {control} alone"
    if isinstance(word, str) and control == "accuracy":
        reason = f"accuracy: {word} sets the method and its tol"
        if integrator.tol is None and integrator.dt is None:
            yield "integrator.method", f"{reason}; leave method out"
    for name in ("accuracy", "tol", "dt"):
        if name != control and getattr(integrator, name) is not None:
            yield f"integrator.{name}", f"{reason}; leave {name} out"
    if integrator.goal and (config.model == "gh" or config.goes_on):
        yield (
            "integrator",
            "accuracy {t_r: ...} excludes model gh and record reversals, spectrum or "
            "late; keep one",
        )


def _records(config: Config) -> Iterator[Clash]:
    early = config.classify.early
    recorded = {*config.record}
    is_paraboloid = CONSTANT_OF_SURFACE[config.bodies.bottom] is None
    plain = is_paraboloid and not config.acting
    if early and not (plain and config.model == "full"):
        yield (
            "classify",
            "early needs model full and paraboloids without dissipation; leave it out",
        )
    for name in ("lyapunov", "spectrum"):
        if name in recorded and not plain:
            needs = f"{name} needs paraboloids without dissipation; leave it out"
            yield "record", needs
    if {"spectrum", "error"} <= recorded:
        yield "record", "spectrum and error exclude each other; keep one"
    whole = {"lyapunov", "spectrum", "volume", "reversals", "late", "casimir"}
    if early and whole & recorded:
        yield (
            "record",
            "lyapunov, spectrum, volume, reversals, late and casimir need whole runs; "
            "leave classify.early out",
        )


def _body_clashes(config: Config) -> Iterator[Clash]:
    bodies = config.bodies
    if isinstance(bodies, ShapeSource):
        yield from _shape(bodies)
        return
    if isinstance(bodies, MeshSource):
        if (bodies.mass is None) == (bodies.density is None):
            yield "bodies.mass", "give mass or density, and not both"
        return
    yield from _constants(bodies)
    if isinstance(bodies, PresetSource):
        yield from _one_angle("overrides", bodies.overrides)
    if isinstance(bodies, GridSource):
        yield from _one_angle("base", bodies.base)
        yield from _one_angle("axes", bodies.axes)
        yield from _grid(bodies)
    if isinstance(bodies, SdSource):
        yield from _drawn(bodies)


def _constants(bodies: Surfaced) -> Iterator[Clash]:
    """Compare the further constants that are given with that of the surface."""
    needed = CONSTANT_OF_SURFACE[bodies.bottom]
    surface_of_bodies = with_article(bodies.bottom)
    for surface, name in CONSTANT_OF_SURFACE.items():
        if name is not None and name != needed and bodies.constant(name) is not None:
            yield (
                f"bodies.{name}",
                f"{surface_of_bodies} has no {name}; take surface: {surface}",
            )
    if isinstance(bodies, GridSource):
        for name in bodies.axes.given.keys() & SURFACE_CONSTANTS.keys() - {needed}:
            yield f"bodies.axes.{name}", f"{surface_of_bodies} has no {name}; drop it"
    # A table may have a column for it.
    if needed is None or needed in bodies.constants or bodies.source == FROM_TABLE:
        return
    constant = SURFACE_CONSTANTS[needed]
    yield (
        "bodies.surface",
        f"{surface_of_bodies} needs its {constant.noun}; give {needed}, such as "
        f"{needed}: {constant.example}",
    )


def _one_angle(name: str, section: Base) -> Iterator[Clash]:
    if len(section.given.keys() & {"xi", *ANGLES}) > 1:
        yield (
            f"bodies.{name}",
            "xi, xi_deg and minus_xi_deg exclude each other; keep one",
        )


def _shape(bodies: ShapeSource) -> Iterator[Clash]:
    if bodies.samples is not None and not bodies.drawn:
        yield (
            "bodies.samples",
            "no key is a range, so all bodies are equal; leave it out",
        )
    thinnest = min(bodies.length[0] / 2, bodies.width[0] / 2, bodies.height[0])
    if bodies.wall is not None and bodies.wall >= thinnest:
        yield (
            "bodies.wall",
            "the wall is not thinner than the stone, which has "
            f"{1e3 * thinnest:g} mm from its middle to its surface; leave wall out if "
            "it is solid",
        )
    if (bodies.weights is None) != (bodies.at is None):
        yield "bodies.weights", "weights and at belong together; give both"
    elif bodies.at is not None:
        # The body with the shortest sides is the first from which a weight would fall.
        x, y = bodies.at
        length = bodies.length[0]
        width = bodies.width[0]
        if (2 * x / length) ** 2 + (2 * y / width) ** 2 > 1:
            yield (
                "bodies.at",
                "the weight lies beyond the edge of the flat side; move it",
            )


def _drawn(bodies: SdSource) -> Iterator[Clash]:
    ranges = bodies.ranges
    target = bodies.target
    if ranges.phi[1] >= ranges.theta[0]:
        yield "bodies.ranges.phi", "phi >= theta is possible; separate the two ranges"
    if ranges.minus_xi_deg[1] == 0:
        yield (
            "bodies.ranges.minus_xi_deg",
            "only xi = 0 is possible, which never reverses",
        )
    if bodies.c and bodies.c[0] <= ranges.theta[1]:
        yield (
            "bodies.c",
            "c <= theta is possible, and such a body lies on its side; raise c",
        )
    if target is None:
        return
    if target.K_r and target.K_p:
        yield "bodies.target", "K_r and K_p exclude each other; keep one"
    elif not target.values:
        yield "bodies.target", "neither K_r nor K_p is given; add one"
    if bodies.draw != "random":
        yield (
            "bodies.target",
            "only random draws can meet a target; take draw: random",
        )


def _grid(bodies: GridSource) -> Iterator[Clash]:
    base = bodies.base
    axes = bodies.axes.given
    needed = {"gamma", "theta", "phi", "xi"}
    if base.f_sd is None:
        needed |= {"alpha", "beta"}
        replaced = {"f_sd"}
    else:
        needed.add("f_sd")
        replaced = {"alpha", "beta"}
    if base.preset:
        needed = set()
    if base.parameters.keys() != needed:
        yield (
            "bodies.base",
            "give a preset alone, or gamma theta phi xi with alpha beta or with f_sd",
        )
    for name in sorted(axes.keys() & replaced):
        yield (
            "bodies.axes",
            f"{name} cannot vary: f_sd stands in place of alpha and beta",
        )
    for name in SURFACE_CONSTANTS:
        values = bodies.constant(name)
        if values and (name in axes or (len(values) > 1 and bodies.refine)):
            yield (
                f"bodies.{name}",
                f"{name} clashes with axes.{name} or refine; write axes: {{{name}: "
                "...} alone",
            )
