"""How states move, as a part of a sweep: a method and its tolerance or step."""

from typing import Annotated, Any, Literal, NamedTuple

from pydantic import (
    ConfigDict,
    Discriminator,
    Field,
    JsonValue,
    Tag,
    ValidationInfo,
    field_validator,
    model_validator,
)

from rattlesweep.integrate.defaults import DT, MAX_STEPS, TOL
from rattlesweep.integrate.tableau import METHODS
from rattlesweep.sweeps.config.fields import Base
from rattlesweep.sweeps.config.messages import not_one_of


class Accuracy(NamedTuple):
    """A method, its tolerance, and the error of t_r that they were measured to give."""

    method: str
    tol: float
    median: float
    p99: float

    @property
    def words(self) -> str:
        """The same for people."""
        return (
            f"{self.method} at tol {self.tol:.0e}, median error of t_r {self.median:.0e}, "
            f"99 % of runs within {self.p99:.0e}"
        )


ACCURACIES = {
    "draft": Accuracy("dop853", 1e-6, 1.4e-7, 7.5e-6),
    "standard": Accuracy("dop853", TOL, 8.7e-11, 7.6e-9),
    "reference": Accuracy("verner98", 1e-12, 1.6e-14, 1.3e-12),
}
"""Words for how accurate runs shall be.

The errors are relative, and those that ``rattlesweep tradeoff`` finds for the bodies, launches and
horizons of ``configs/tradeoff.yaml``; they do not depend on the machine.
"""


class AccuracyGoal(Base):
    """The error that the results may have."""

    t_r: float = Field(ge=1e-12, le=1e-3)
    """Relative error of the times of reversal. Each run is integrated as tightly as it takes until
    its own estimate is below that; where none is, its t_r_error stays larger."""


AccuracyWord = Literal["draft", "standard", "reference"]
WordOrGoal = Annotated[
    Annotated[AccuracyWord, Tag("word")] | Annotated[AccuracyGoal, Tag("AccuracyGoal")],
    Discriminator(
        lambda value: "AccuracyGoal" if isinstance(value, dict | AccuracyGoal) else "word"
    ),
]


ADAPTIVE: list[JsonValue] = [name for name, tableau in METHODS.items() if tableau.adaptive]


class Integrator(Base):
    """How states move: with error control (tol) or in steps of one size (dt)."""

    model_config = ConfigDict(
        json_schema_extra={
            "dependentSchemas": {
                "accuracy": {
                    "anyOf": [
                        {"properties": {"accuracy": {"type": "null"}}},
                        {"properties": {"method": False, "tol": {"type": "null"},
                                        "dt": {"type": "null"}}},
                        {"properties": {"accuracy": {"type": "object"}, "tol": {"type": "null"},
                                        "method": {"enum": ADAPTIVE}, "dt": {"type": "null"}}},
                    ]
                }
            }
        }
    )  # fmt: skip

    method: str = Field(default="dop853", json_schema_extra={"enum": [*METHODS]})
    """Name of the method."""
    accuracy: WordOrGoal | None = Field(
        default=None,
        description="Instead of method and tol, which are then those measured to give this "
        f"accuracy: {'; '.join(f'{name}: {one.words}' for name, one in ACCURACIES.items())}. Or "
        "instead of tol the error that t_r may have, {t_r: 1.0e-6}; implies record: [error].",
    )
    tol: float | None = Field(
        default=None,
        ge=1e-15,
        le=1e-2,
        validate_default=True,
        description="Error allowed per step relative to the oscillation, no unit; for adaptive "
        f"methods only, which take {TOL:g} unless given.",
    )
    dt: float | None = Field(
        default=None,
        gt=0,
        validate_default=True,
        description="Size of a step in sqrt(a/g); for methods of fixed step only, which take "
        f"{DT:g} unless given.",
    )
    max_steps: int = Field(default=MAX_STEPS, ge=1, le=2**62)
    """Steps after which a run is given up."""

    rules = (
        ("accuracy", lambda i: isinstance(i.accuracy, str),
         "{accuracy} stands for a method and its tol, and method, tol or dt is given too; keep the "
         "one or the other"),
        ("accuracy", lambda i: i.accuracy and i.method and i.method not in ADAPTIVE,
         "{method} has steps of one size, which follow no error; choose one of "
         f"{', '.join(map(str, ADAPTIVE))}"),
        *((key, lambda i, key=key: i.accuracy and getattr(i, key) is not None,
           "accuracy {{t_r: {accuracy.t_r:g}}} stands in its place; keep one of the two")
          for key in ("tol", "dt")),
        ("tol", lambda i: i.tol is not None and i.method and i.method not in ADAPTIVE,
         "{method} has steps of one size and takes no tol; leave it out"),
        ("dt", lambda i: i.dt is not None and i.method in ADAPTIVE,
         "{method} chooses its own steps and takes no dt; leave it out"),
    )  # fmt: skip

    @property
    def goal(self) -> float | None:
        """Relative error that t_r may have, if that is what decides."""
        return self.accuracy.t_r if isinstance(self.accuracy, AccuracyGoal) else None

    @model_validator(mode="before")
    @classmethod
    def _spelled_out(cls, data: Any) -> Any:
        """Put method and tol in the place of `accuracy`: configs that mean the same are equal."""
        if not isinstance(data, dict) or "method" in data:
            return data
        word = data.get("accuracy")
        given = [key for key in ("tol", "dt") if data.get(key) is not None]
        if given or not isinstance(word, str) or word not in ACCURACIES:
            return data
        rest = {key: value for key, value in data.items() if key not in ("accuracy", "tol", "dt")}
        return {"method": ACCURACIES[word].method, "tol": ACCURACIES[word].tol} | rest

    @field_validator("method")
    @classmethod
    def _known(cls, method: str) -> str:
        if method not in METHODS:
            raise ValueError(not_one_of(method, METHODS))
        return method

    @field_validator("accuracy", mode="before")
    @classmethod
    def _no_bare_number(cls, accuracy: Any) -> Any:
        if isinstance(accuracy, int | float) and not isinstance(accuracy, bool):
            raise ValueError(
                f"{accuracy!r} is a number; write {{t_r: {accuracy!r}}} for the error that t_r "
                f"may have, or one of {', '.join(ACCURACIES)}"
            )
        return accuracy

    @field_validator("tol", "dt")
    @classmethod
    def _of_its_method(cls, value: float | None, info: ValidationInfo) -> float | None:
        """`tol` is of adaptive methods, `dt` of those of fixed step; each has its default."""
        method, default = info.data.get("method"), TOL if info.field_name == "tol" else DT
        takes = method and METHODS[method].adaptive == (info.field_name == "tol")
        return default if value is None and takes and not info.data.get("accuracy") else value
