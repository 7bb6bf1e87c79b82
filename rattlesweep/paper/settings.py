"""Settings of the paper's figures: read, checked, cut down for ``--quick``."""

from __future__ import annotations

from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pydantic import Field, ValidationError, field_validator

from rattlesweep.errors import ConfigError, one_line
from rattlesweep.paper.figures.examples import Examples
from rattlesweep.paper.figures.fig2 import Fig2Settings
from rattlesweep.paper.figures.fig3 import Fig3Settings
from rattlesweep.paper.figures.fig4 import Fig4Settings
from rattlesweep.paper.figures.fig5 import Fig5Settings
from rattlesweep.paper.figures.fig8 import Fig8Settings
from rattlesweep.paper.figures.fig8_lyapunov import Fig8LyapunovSettings
from rattlesweep.sweeps.config import yamlfile
from rattlesweep.sweeps.config.bodies import SdSource
from rattlesweep.sweeps.config.fields import Base, PositiveNumbers
from rattlesweep.sweeps.config.messages import describe
from rattlesweep.sweeps.config.places import Places
from rattlesweep.sweeps.config.schema import Config
from rattlesweep.sweeps.config.validation import problems_of

if TYPE_CHECKING:
    import os
    from collections.abc import Mapping

    from rattlesweep.sweeps.config.yamlfile import Document

# Samples of a point with --quick.
QUICK_SAMPLES = 30
# Wobbling runs with their Lyapunov exponents, with --quick.
QUICK_LYAPUNOV = 200


class Rk4(Base):
    """The check of Fig. 6 by the paper's own integrator."""

    samples: int = Field(ge=1, description="Samples of each case that are integrated once more.")
    dt: float = Field(gt=0, description="Step, in sqrt(a/g).")
    least_K_r: float = Field(
        default=0.0, ge=0, description="Targets of K_r below this are left out: they take longest."
    )


class Basin(Base):
    """How large an oscillation a stable steady spin bears."""

    n_i: float = Field(lt=0, description="Spin, in sqrt(g/a).")
    omega_xy0: PositiveNumbers = Field(description="Sizes of the oscillation, in sqrt(g/a).")


class Fig6Settings(Base):
    """What is measured for Fig. 6 beyond its sweep."""

    rk4: Rk4
    basin: Basin
    examples: Examples
    lyapunov: int = Field(ge=1, description="Most wobbling runs that are tried for chaos.")


class Fig7Settings(Base):
    """What is measured for Fig. 7 beyond its sweep."""

    late: float = Field(gt=0, description="A reversal is late after this many t_rGH.")
    closer: int = Field(ge=1, description="Most runs that are followed in windows of time.")


class Paper(Base):
    """All settings, one section a figure or sweep."""

    fig2: Fig2Settings
    fig3: Fig3Settings
    fig4: Fig4Settings
    fig5: Fig5Settings
    unsteady: Config
    steady: Config
    fig6: Fig6Settings
    fig7: Fig7Settings
    fig8: Fig8Settings
    fig8_lyapunov: Fig8LyapunovSettings

    @field_validator("unsteady")
    @classmethod
    def _in_the_unsteady_direction(cls, config: Config) -> Config:
        return _fits(config, "K_p", positive=True)

    @field_validator("steady")
    @classmethod
    def _in_the_steady_direction(cls, config: Config) -> Config:
        return _fits(config, "K_r", positive=False)

    def quick(self) -> Paper:
        """Enough to see every figure, in seconds."""
        return self.model_copy(
            update={
                "fig2": self.fig2.quick(),
                "fig3": self.fig3.quick(),
                "unsteady": _fewer(self.unsteady),
                "steady": _fewer(self.steady),
                "fig8_lyapunov": self.fig8_lyapunov.quick(),
                "fig6": self.fig6.model_copy(
                    update={
                        "rk4": self.fig6.rk4.model_copy(update={"samples": 1, "least_K_r": 0.03}),
                        "lyapunov": min(self.fig6.lyapunov, QUICK_LYAPUNOV),
                    }
                ),
            }
        )


def _fits(config: Config, name: str, *, positive: bool) -> Config:
    bodies = config.bodies
    target = bodies.target if isinstance(bodies, SdSource) else None
    if target is None or target.name != name:
        raise ValueError(f"bodies must be of source sd and have a target {name}; add one")
    if config.spin is None or any((n > 0) is not positive for n in config.spin.n_i):
        sign = "positive" if positive else "negative"
        raise ValueError(f"every spin.n_i must be {sign} in this section; change its sign")
    if config.model != "full":
        raise ValueError(f"the model is {config.model}; the figures are of the model full")
    return config


def _fewer(config: Config) -> Config:
    bodies = config.bodies
    assert isinstance(bodies, SdSource)
    samples = min(bodies.samples, QUICK_SAMPLES)
    return config.model_copy(update={"bodies": bodies.model_copy(update={"samples": samples})})


def shipped() -> str:
    """Text of the settings that come with the package."""
    return resources.files(__package__).joinpath("paper.yaml").read_text("utf-8")


def load_paper(path: str | os.PathLike[str] | None = None) -> Paper:
    """Read the settings.

    Parameters
    ----------
    path
        YAML 1.2 file with some or all sections of the shipped one; without it, that one.

    Raises
    ------
    ConfigError
        With everything that is wrong, one line each: file, line, column, key, sentence.
    """
    own = yamlfile.parse(shipped())
    if path is None:
        return _checked(own, own.data, "paper.yaml")
    file = one_line(str(Path(path)), 200)
    given = yamlfile.parse(yamlfile.read_text(path))
    if given.broken:
        raise ConfigError(_places(given, file).lines(given.problems))
    if given.data is None:
        raise ConfigError(f"{file}:1:1: the file is empty; give at least one section")
    if not isinstance(given.data, dict):
        raise ConfigError(
            f"{file}:1:1: {describe(given.data)} found where a mapping is needed; write "
            "sections such as fig6:"
        )
    return _checked(given, {**own.data, **given.data}, file)


def _places(document: Document, file: str) -> Places:
    return Places(file, {(): (1, 1), **document.positions})


def _checked(document: Document, data: Mapping[str, Any], file: str) -> Paper:
    places, problems = _places(document, file), list(document.problems)
    found, more = None, 0
    try:
        found = Paper.model_validate(data)
    except ValidationError as error:
        known = {problem.key for problem in problems}
        news, more = problems_of(error, Paper, data, known, places)
        problems += news
    if problems or found is None:
        raise ConfigError(places.lines(problems, more))
    return found
