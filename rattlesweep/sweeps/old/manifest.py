"""``manifest.json``: what a sweep is and how far it is, typed, and checked before it is believed.

It is input, like a config: strict in what this version relies on, while keys that a later one adds
are left alone and written again. What has its default is not written.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import pyarrow as pa
from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    ValidationError,
    ValidationInfo,
    field_serializer,
    field_validator,
    model_validator,
)

from rattlesweep.errors import ConfigError, DamagedError, one_line
from rattlesweep.sweeps.decide import borders, n_blocks
from rattlesweep.sweeps.config.bodies import SdSource, TableSource
from rattlesweep.sweeps.config.load import override_config, resolved
from rattlesweep.sweeps.config.schema import Config
from rattlesweep.sweeps.provenance import command_line, machine, now, versions
from rattlesweep.sweeps import columns

if TYPE_CHECKING:
    from rattlesweep.sweeps.plan import Plan

FORMAT: Literal[2] = 2


def _is_time(text: str) -> str:
    if datetime.fromisoformat(text).tzinfo is None:
        raise ValueError("the time has no zone")
    return text


Count = Annotated[int, Field(ge=0, le=2**62)]
Seconds = Annotated[float, Field(ge=0, le=1e18)]
Sha256 = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]
Time = Annotated[str, Field(max_length=64), AfterValidator(_is_time)]
Failed = dict[str, Count]
Versions = dict[str, str]
Machine = dict[str, str | int | None]


class _Part(BaseModel):
    model_config = ConfigDict(strict=True, allow_inf_nan=False, extra="allow")


class Receipt(_Part):
    """What is kept of a block: its file's checksum, its rows and its failed runs by status.

    `seconds` is the time of its integration, None where that is not known; `sensitive` and `unsure`
    count runs as `summary` does, None where no errors are recorded.
    """

    sha256: Sha256
    rows: Count
    bytes: Count
    failed: Failed = {}
    seconds: Seconds | None = None
    sensitive: Count | None = None
    unsure: Count | None = None

    def took(self, seconds: float | None) -> Receipt:
        """The same with the time of its integration."""
        return self.model_copy(update={"seconds": None if seconds is None else round(seconds, 4)})


class StoredCase(_Part):
    """A case; a target is there only where it has one, and dissipation likewise."""

    case: Count
    K_p: float | None = None
    K_r: float | None = None
    n_i: float | None = None
    omega_xy0: float | None = None
    sigma: float | None = None
    rolling: float | None = None

    @property
    def target_name(self) -> str | None:
        """``"K_p"``, ``"K_r"`` or none."""
        return next((name for name in ("K_p", "K_r") if getattr(self, name) is not None), None)

    @property
    def target(self) -> float | None:
        """Target value of that."""
        return self.K_r if self.K_p is None else self.K_p


class ExtraColumn(_Part):
    """A column of the runs that their bodies and launches bring along."""

    name: str
    type: Literal["double", "int64", "string"]
    unit: str
    description: str
    nullable: bool

    @classmethod
    def of(cls, field: pa.Field) -> ExtraColumn:
        """What is to be kept of it."""
        words = {key.decode(): text.decode() for key, text in field.metadata.items()}
        kept = {"name": field.name, "type": str(field.type), "nullable": field.nullable}
        return cls.model_validate(kept | words)

    @property
    def field(self) -> pa.Field:
        """The column itself."""
        kind = pa.type_for_alias(self.type)
        return columns.field(self.name, kind, self.unit, self.description, nullable=self.nullable)


class SessionProgress(_Part):
    """How far a session is; `left` in seconds, None where it cannot tell."""

    at: Time
    left: Seconds | None


class SessionRecord(_Part):
    """One process's work on a sweep; `directory` to `command` once it is merged with others."""

    directory: str | None = None
    versions: Versions | None = None
    machine: Machine | None = None
    command: list[str] | None = None
    started: Time
    state: Literal["running", "stopped", "complete"]
    shard: str | None = None
    host: str | None = None
    pid: int | None = None
    threads: int | None = None
    finished: Time | None = None
    seconds: Seconds | None = None
    load_seconds: Seconds | None = None
    kernel_seconds: Seconds | None = None
    blocks: Count | None = None
    peak_memory: Count | None = None
    progress: SessionProgress | None = None

    @property
    def key(self) -> tuple[Any, ...]:
        """What tells it from every other session."""
        return self.started, self.host, self.pid, self.shard


class Classified(_Part):
    """Thresholds of the sweep's config, and those by which `classify` typed its runs since."""

    config: dict[str, float]
    now: dict[str, float]
    at: Time


class Expected(_Part):
    """What a sweep was expected to take, with the ends of an interval, in seconds."""

    seconds: Seconds = 0.0
    low: Seconds = 0.0
    high: Seconds = 0.0
    pilot_runs: Count | None = None


class Manifest(_Part):
    """What ``manifest.json`` says.

    `config` has the block size that the directory was begun with, `config_hash` is that of what
    determines the numbers (:func:`rattlesweep.sweeps.provenance.identity`), `base` is where
    the relative path of a table of bodies starts. There are receipts of complete blocks only.
    `stages` has the runs of each stage known so far, of a sweep that decides what to run next.
    `growing` says that the blocks are still those of a smaller sweep.
    """

    format: Literal[2]
    name: str
    state: Literal["running", "stopped", "partial", "complete"]
    config: Config
    config_hash: Sha256
    base: Annotated[str, Field(pattern=r"^[^\x00]*$")] | None = None
    cases: list[StoredCase] = Field(min_length=1)
    columns: list[ExtraColumn] = []
    samples: Count
    runs: Count
    blocks: Count
    stages: list[Count] | None = None
    versions: Versions
    machine: Machine
    started: Time
    command: list[str]
    commands: list[list[str]] = []
    failed: Failed
    sessions: list[SessionRecord]
    receipts: dict[Annotated[int, Field(strict=False, ge=0, lt=10**18)], Receipt]  # by block
    expected: Expected | None = None
    finished: Time | None = None
    seconds: Seconds = 0.0
    kernel_seconds: Seconds = 0.0
    bytes: Count = 0
    peak_memory: Count | None = None
    classified: Classified | None = None
    growing: Literal[True] | None = None

    @field_validator("config", mode="before")
    @classmethod
    def _is_a_config(cls, data: Any) -> Config:
        if isinstance(data, Config):
            return data
        if not isinstance(data, dict):
            raise ValueError("it is no config")
        try:
            return override_config(data, [])
        except ConfigError as error:
            raise ValueError(error.messages[0]) from None

    @field_validator("cases")
    @classmethod
    def _are_the_configs(cls, cases: list[StoredCase], info: ValidationInfo) -> list[StoredCase]:
        config = info.data.get("config")
        if [case.case for case in cases] != list(range(len(cases))):
            raise ValueError("they are not numbered from 0")
        if config is not None and not isinstance(config.bodies, TableSource):
            spin = config.spin
            launches = 1 if spin is None else len(spin.n_i) * len(spin.omega_xy0)
            targets = max(1, len(targets_of(config)))
            if len(cases) != targets * launches * len(config.dissipation.cases):
                raise ValueError("they are not those of its config")
        if config is not None and config.dissipation:
            # Manifests of before do not say of each what all share.
            shared = zip(("sigma", "rolling"), config.dissipation.cases[0], strict=True)
            for name, value in shared:
                for case in cases:
                    if value is not None and getattr(case, name) is None:
                        setattr(case, name, value)
        return cases

    @model_validator(mode="after")
    def _add_up(self) -> Manifest:
        bodies = self.config.bodies
        if isinstance(bodies, SdSource) and self.samples != bodies.samples:
            raise ValueError("its samples are not those of its config")
        if self.runs != sum(self.sizes):
            raise ValueError("its runs are not cases times samples, or those of its stages")
        if self.blocks != n_blocks(self.sizes, self.config.block_size):
            raise ValueError("its blocks are not those of its runs")
        return self

    @field_serializer("config")
    def _resolved(self, config: Config) -> dict[str, Any]:
        return resolved(config)

    @classmethod
    def parse(cls, data: dict[str, Any]) -> Manifest:
        """Check what was read from ``manifest.json``; a ConfigError if it is of another format.

        If something in it cannot be, a DamagedError says what, in a few words fit for a terminal.
        """
        found = data.get("format")
        if isinstance(found, int) and found != FORMAT:
            raise ConfigError(
                f"it was written in format {found}; this version writes format {FORMAT}, so "
                "choose another output or start over with --fresh"
            )
        try:
            return cls.model_validate(data)
        except ValidationError as error:
            first = error.errors(include_url=False, include_input=False, include_context=False)[0]
            where = ".".join(map(str, first["loc"]))
            what = first["msg"].removeprefix("Value error, ")
            raise DamagedError(one_line(f"{where}: {what}" if where else what, 300)) from None

    @classmethod
    def begin(cls, plan: Plan, hash_: str, base: Path | None) -> Manifest:
        """The manifest of a sweep that begins."""
        return cls(
            format=FORMAT,
            name=plan.config.name,
            state="running",
            config=plan.config,
            config_hash=hash_,
            base=None if base is None else str(base),
            cases=[
                StoredCase(
                    case=case.index,
                    n_i=case.n_i,
                    omega_xy0=case.omega_xy0,
                    sigma=case.sigma,
                    rolling=case.rolling,
                    **({case.target_name: case.target} if case.target_name else {}),
                )
                for case in plan.cases
            ],
            columns=[ExtraColumn.of(field) for field in plan.extra],
            samples=plan.samples,
            runs=plan.runs,
            blocks=plan.n_blocks,
            stages=plan.sizes if plan.stages else None,
            versions=versions(),
            machine=machine(),
            started=now(),
            command=command_line(),
            failed={},
            sessions=[],
            receipts={},
        )

    def dump(self) -> dict[str, Any]:
        """As JSON has it, receipts in their order."""
        data = self.model_dump(exclude_defaults=True)
        receipts = sorted(data["receipts"].items())
        return data | {"receipts": {str(index): receipt for index, receipt in receipts}}

    @property
    def sizes(self) -> list[int]:
        """Runs of each stage; of a sweep that has none, all of them."""
        return self.stages or [self.samples * len(self.cases)]

    @property
    def extra(self) -> tuple[pa.Field, ...]:
        """Columns of its runs that their bodies and launches bring along."""
        return tuple(column.field for column in self.columns)

    @property
    def schema(self) -> pa.Schema:
        """Of its runs."""
        return columns.runs_schema(self.config.parts, self.config.model, self.extra)

    def borders(self, index: int) -> tuple[int, int]:
        """Places of the runs of a block, from and up to."""
        return borders(self.sizes, self.config.block_size, index)

    def forget(self, indices: Iterable[int]) -> None:
        """Drop the receipts of blocks that are about to be replaced."""
        for index in indices:
            self.receipts.pop(index, None)

    def add_up(self) -> None:
        """Count what its receipts and sessions come to."""
        self.failed = count_failed(self.receipts.values())
        self.bytes = sum(receipt.bytes for receipt in self.receipts.values())
        for name in ("seconds", "kernel_seconds"):
            total = sum(getattr(session, name) or 0.0 for session in self.sessions)
            setattr(self, name, round(total, 3))


def targets_of(config: Config) -> Sequence[float]:
    """The targets that bodies are drawn for, if they are."""
    target = config.bodies.target if isinstance(config.bodies, SdSource) else None
    return [] if target is None else target.values


def count_failed(receipts: Iterable[Receipt]) -> dict[str, int]:
    """Runs by status, other than ``ok``."""
    failed: Counter[str] = Counter()
    for receipt in receipts:
        failed.update(receipt.failed)
    return dict(sorted(failed.items()))
