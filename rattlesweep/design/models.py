"""The equations that a config asks for, and the constants that they take."""

import numpy as np

from rattlesweep.arrays import Floats
from rattlesweep.config.schema import Config
from rattlesweep.motion.model import Model, find_model, reduced_model
from rattlesweep.physics import full, surface
from rattlesweep.physics.surface import Surface
from rattlesweep.rows.prepared import Bodies
from rattlesweep.words.errors import ConfigError
from rattlesweep.words.quantities import CONSTANT_OF_SURFACE


def surface_constant(bodies: Bodies, of_surface: Surface) -> Floats:
    """Return the further constant of a surface as models take it; 0 for paraboloids."""
    name = CONSTANT_OF_SURFACE[of_surface.name]
    none = np.full(len(bodies.alpha), np.nan)
    values = none if name is None else bodies.further.get(name, none)
    return of_surface.constant(values)


def constants_of(bodies: Bodies) -> Floats:
    """Return the six constants of the full equations; shape (6, bodies)."""
    return full.constants(
        bodies.alpha, bodies.beta, bodies.gamma, bodies.theta, bodies.phi, bodies.xi
    )


def model_of(config: Config) -> Model:
    """Return the equations that a sweep integrates; the model gh has none."""
    if config.model == "reduced":
        return reduced_model(config.dissipation.present)
    if config.model != "full":
        return find_model(config.model)
    return full_model_of(config)


def full_model_of(config: Config) -> Model:
    """Return the equations of a config for `model: full`."""
    words = [surface.SURFACES[config.bodies.bottom].model, config.acting.law]
    if config.dissipation.slides:
        words.append("sliding")
    model = find_model("_".join(filter(None, words)))
    if "volume" in config.record and model.volume is None:
        acting = [*config.dissipation.present]
        if config.acting.is_shaken:
            acting.append("base")
        raise ConfigError(
            f"record: the phase volume is not known with {' and '.join(acting)}; leave "
            "volume out"
        )
    return model
