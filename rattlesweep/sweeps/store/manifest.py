"""What a manifest must be before any of it is believed: it is input, like a config."""

from __future__ import annotations

from datetime import datetime
from typing import Annotated, Any, Literal

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    ValidationError,
    ValidationInfo,
    field_validator,
    model_validator,
)

from rattlesweep.errors import ConfigError, one_line
from rattlesweep.sweeps.config.bodies import SdSource, TableSource
from rattlesweep.sweeps.config.load import override_config
from rattlesweep.sweeps.config.schema import Config

FORMAT = 2


def _is_time(text: str) -> str:
    if datetime.fromisoformat(text).tzinfo is None:
        raise ValueError("the time has no zone")
    return text


Count = Annotated[int, Field(ge=0, le=2**62)]
Seconds = Annotated[float, Field(ge=0, le=1e18)]
Sha256 = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]
Time = Annotated[str, Field(max_length=64), AfterValidator(_is_time)]
Failed = dict[str, Count]


class _Part(BaseModel):
    """Strict in what this version relies on; what a later one adds is left alone."""

    model_config = ConfigDict(strict=True, allow_inf_nan=False)


class _Case(_Part):
    case: Count
    K_p: float | None = None
    K_r: float | None = None
    n_i: float | None = None
    omega_xy0: float | None = None


class _Receipt(_Part):
    sha256: Sha256
    rows: Count
    bytes: Count
    failed: Failed = {}
    seconds: Seconds | None = None


class _Progress(_Part):
    at: Time
    left: Seconds | None


class _Session(_Part):
    started: Time
    state: Literal["running", "stopped", "complete"]
    finished: Time | None = None
    seconds: Seconds = 0.0
    kernel_seconds: Seconds = 0.0
    peak_memory: Count | None = None
    progress: _Progress | None = None


class _Classified(_Part):
    config: dict[str, float]
    now: dict[str, float]
    at: Time


class _Expected(_Part):
    seconds: Seconds = 0.0
    low: Seconds = 0.0
    high: Seconds = 0.0


class Manifest(_Part):
    """The parts of ``manifest.json`` that commands rely on."""

    format: Literal[2]
    name: str
    state: Literal["running", "stopped", "partial", "complete"]
    config: Config
    config_hash: Sha256
    base: Annotated[str, Field(pattern=r"^[^\x00]*$")] | None = None
    cases: list[_Case] = Field(min_length=1)
    samples: Count
    runs: Count
    blocks: Count
    versions: dict[str, str]
    machine: dict[str, str | int | None]
    started: Time
    finished: Time | None = None
    command: list[str]
    commands: list[list[str]] = []
    failed: Failed
    sessions: list[_Session]
    receipts: dict[Annotated[str, Field(pattern=r"^[0-9]{1,18}$")], _Receipt]
    seconds: Seconds = 0.0
    kernel_seconds: Seconds = 0.0
    bytes: Count = 0
    peak_memory: Count | None = None
    expected: _Expected | None = None
    classified: _Classified | None = None

    @field_validator("config", mode="before")
    @classmethod
    def _is_a_config(cls, data: Any) -> Config:
        if not isinstance(data, dict):
            raise ValueError("it is no config")
        try:
            return override_config(data, [])
        except ConfigError as error:
            raise ValueError(error.messages[0]) from None

    @field_validator("cases")
    @classmethod
    def _are_the_configs(cls, cases: list[_Case], info: ValidationInfo) -> list[_Case]:
        config = info.data.get("config")
        if [case.case for case in cases] != list(range(len(cases))):
            raise ValueError("they are not numbered from 0")
        if config is not None and not isinstance(config.bodies, TableSource):
            target = config.bodies.target if isinstance(config.bodies, SdSource) else None
            targets = 1 if target is None else len(target.values)
            if len(cases) != targets * len(config.spin.n_i) * len(config.spin.omega_xy0):
                raise ValueError("they are not those of its config")
        return cases

    @model_validator(mode="after")
    def _add_up(self) -> Manifest:
        bodies = self.config.bodies
        if isinstance(bodies, SdSource) and self.samples != bodies.samples:
            raise ValueError("its samples are not those of its config")
        if self.runs != self.samples * len(self.cases):
            raise ValueError("its runs are not cases times samples")
        if self.blocks != -(-self.runs // self.config.block_size):
            raise ValueError("its blocks are not those of its runs")
        return self


def check(data: dict[str, Any]) -> Manifest:
    """Check what was read from ``manifest.json``.

    Raises
    ------
    ValueError
        Something in it cannot be; says what, in a few words fit for a terminal.
    """
    try:
        return Manifest.model_validate(data)
    except ValidationError as error:
        first = error.errors(include_url=False, include_input=False, include_context=False)[0]
        where = ".".join(map(str, first["loc"]))
        what = first["msg"].removeprefix("Value error, ")
        raise ValueError(one_line(f"{where}: {what}" if where else what, 300)) from None
