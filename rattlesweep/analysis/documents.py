"""The JSON that commands print by ``--json``, and its JSON Schemas.

A number that is not finite is null.  Keys may be added in later versions; none is
renamed or dropped.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from pydantic import BaseModel, ConfigDict, Field, create_model

from rattlesweep.analysis.contact import QUANTITIES_OF_PATCH
from rattlesweep.analysis.derived import DERIVED
from rattlesweep.store.sessions import Record
from rattlesweep.words.names import DOCUMENT_NAMES

_DIALECT = "https://json-schema.org/draft/2020-12/schema"
# Keys of `body` that depend on the body and its losses.
_OPTIONAL = ("c", *list(DERIVED)[list(DERIVED).index("growth_roll_exact") + 1 :])


class _Document(BaseModel):
    """A mapping without further keys."""

    model_config = ConfigDict(extra="forbid", use_attribute_docstrings=True)


class SizeInSI(_Document):
    """The sizes of the units M, a and g."""

    mass: float | None
    """M in kg"""
    length: float | None
    """a in m"""
    gravity: float | None
    """g in m/s^2"""


class ValueInSI(_Document):
    """A quantity in SI units, or a spin in rpm."""

    value: float | None
    unit: str


class MaterialDocument(_Document):
    """A material of a patch of contact."""

    E: float
    """Young's modulus in Pa"""
    nu: float
    """Poisson's ratio"""
    source: str
    """where the constants are from"""


class VerdictRun(_Document):
    """A launch in one direction, with or without friction."""

    friction: str
    """none, or the losses in words"""
    direction: str
    """counterclockwise or clockwise, from above"""
    spin_rpm: float
    """initial spin, without its sign"""
    outcome: str
    """what happens, as in docs/verdict.md"""
    t_s: float | None
    """time at which the spin passes zero"""
    error_s: float | None
    """error of t_s by the integration"""
    reversals: int
    """number of reversals by the end"""
    after_rpm: float | None
    """largest spin after the first reversal"""
    held_s: float | None
    """time at which friction holds the spin at zero for the first time"""
    slides_s: float | None
    """time at which the first slide begins"""
    end_s: float
    """end of the run"""
    status: str
    """ok, or a word for what went wrong"""
    sure: bool
    """whether the outcome is sure"""
    samples: int
    """number of stones drawn from the errors"""
    share: float | None
    """share of them that turn back"""
    low_s: float | None
    """lower end of 95 % of their times"""
    high_s: float | None
    """upper end of 95 % of their times"""


class VerdictChange(_Document):
    """What makes a launch turn back, with all friction."""

    direction: str
    """counterclockwise or clockwise, from above"""
    spin_rpm: float
    """initial spin, without its sign"""
    change: str
    """spin, skew, lever or weights"""
    value: float
    """how large it must be"""
    unit: str
    before: float | None
    """how large it is"""
    words: str
    """the change in words"""
    t_s: float | None
    """time at which the spin passes zero then"""
    sure: bool
    """whether a tighter run agrees"""


class VerdictDocument(_Document):
    """The output of ``rattlesweep verdict --json``."""

    verdict: str
    """the verdict in words, with all the friction"""
    runs: list[VerdictRun]
    advice: list[VerdictChange]
    """what would make it turn back"""
    remarks: list[str]
    """what the table does not show"""


class PlanDocument(_Document):
    """The output of ``rattlesweep plan --json``; ``--check`` has the first three."""

    cases: int = Field(ge=1)
    samples: int = Field(ge=1)
    """number of runs of each case"""
    runs: int = Field(ge=1)
    threads: int = Field(1, ge=1)
    seconds: float = 0.0
    """expected time, without compiling"""
    low: float = 0.0
    """how long it may take, at least, in seconds"""
    high: float = 0.0
    """how long it may take, at most, in seconds"""
    bytes: int = 0
    """size of the files"""
    decides: str | None = None
    """key of the config that makes the sweep skip runs"""


class StatusDocument(_Document):
    """The output of ``rattlesweep status --json``."""

    runs: int = Field(ge=0)
    """number of runs on disk"""
    wanted: int = Field(ge=0)
    """number of runs that the sweep will have"""
    files: int
    bytes: int
    """size of the files"""
    status: dict[str, int]
    """number of runs by status"""
    types: dict[str, int]
    """number of runs by type"""
    damaged: list[str]
    """files that were damaged and set aside"""
    at_work: list[Record]
    """sessions that work now"""
    unknown: list[Record]
    """sessions that work or were killed"""
    last: Record | None
    """last session that is not at work"""


def _quantity(unit: str, meaning: str, is_optional: bool = False) -> tuple[Any, Any]:
    """Return the declaration of a number that theory may lack."""
    default: Any = ...
    if is_optional:
        default = None
    return float | None, Field(
        default, description=meaning, json_schema_extra={"unit": unit}
    )


_OF_SIZE: dict[str, Any] = {
    "units": (
        SizeInSI | None,
        Field(None, description="SI sizes of the units, for a body with a size"),
    ),
    "si": (
        dict[str, ValueInSI] | None,
        Field(None, description="the quantities that have a unit, in SI units"),
    ),
}
# The overloads of `create_model` know no fields from a table.
_model: Callable[..., type[BaseModel]] = create_model
BodyDocument = _model(
    "BodyDocument",
    __base__=_Document,
    __doc__="The output of ``rattlesweep body --json``, in units of the body.",
    **{
        name: _quantity(unit, meaning, name in _OPTIONAL)
        for name, (unit, meaning) in DERIVED.items()
    },
    **_OF_SIZE,
)
ContactDocument = _model(
    "ContactDocument",
    __base__=_Document,
    __doc__="The output of ``rattlesweep contact --json``, in units of the body.",
    **{name: _quantity(unit, meaning) for name, unit, meaning in QUANTITIES_OF_PATCH},
    **_OF_SIZE,
    materials=(
        list[MaterialDocument],
        Field(description="those of body and plane"),
    ),
    remarks=(list[str], Field(description="what the theory leaves out")),
)
DOCUMENTS: dict[str, type[BaseModel]] = dict(
    zip(
        DOCUMENT_NAMES,
        (BodyDocument, ContactDocument, PlanDocument, StatusDocument, VerdictDocument),
        strict=True,
    )
)


def document_schema(name: str) -> dict[str, Any]:
    """Return the JSON Schema of the output of a command."""
    return {"$schema": _DIALECT, **DOCUMENTS[name].model_json_schema()}
