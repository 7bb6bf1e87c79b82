"""A sweep on disk: its manifest and its rows; the way in for everything that reads one.

``manifest.json`` says what the sweep is: config, hash, cases, columns, versions, machine.  It is
written when a sweep begins or grows, and says nothing of what has been done.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pyarrow as pa

from rattlesweep.errors import ConfigError, DamagedError, OutputError
from rattlesweep.sweeps.cases import Case, grown
from rattlesweep.sweeps.columns import runs_schema
from rattlesweep.sweeps.config.read import (
    differences,
    fixed_part,
    parse_config,
    physics_hash,
    resolved,
)
from rattlesweep.sweeps.config.schema import Classify, Config
from rattlesweep.sweeps.files import explained, reason, replace_file
from rattlesweep.sweeps.provenance import LOCKS, at_work, command_line, machine, now, versions
from rattlesweep.sweeps.rows import FOLDER, TYPED, Runs

if TYPE_CHECKING:
    from rattlesweep.sweeps.plan import Plan

MANIFEST, SUMMARY = "manifest.json", "summary.parquet"
FORMAT = 3


@dataclass(frozen=True)
class Stored:
    """An output directory."""

    directory: Path
    manifest: dict[str, Any]  # `manifest.json` as it is
    config: Config  # with all defaults filled in
    cases: tuple[Case, ...]
    extra: tuple[pa.Field, ...]  # columns that the bodies and launches bring along
    samples: int  # of each case
    hash: str  # of what determines the numbers of a run with a given key

    @cached_property
    def runs(self) -> Runs:
        """The rows."""
        return Runs(self.directory)

    @cached_property
    def schema(self) -> pa.Schema:
        """Arrow schema of the runs, with `unit` and `description` in each field's metadata."""
        return runs_schema(self.config.parts, self.config.model, self.extra)

    @property
    def thresholds(self) -> Classify:
        """Thresholds behind the types on disk, which may be those of ``rattlesweep classify``."""
        for path in self.files():
            with contextlib.suppress(DamagedError, ValueError):
                typed = json.loads(self.runs.metadata(path).get(TYPED, "{}"))
                return self.config.classify.model_copy(update=typed)
        return self.config.classify

    @property
    def typed(self) -> str:
        """The same as JSON, as each file of rows has it."""
        return self.thresholds.as_text

    def files(self) -> list[Path]:
        """Return the files of the rows."""
        return self.runs.files()

    def count(self) -> int:
        """Return the number of rows on disk."""
        return sum(len(self.runs.table(path, ["case"])) for path in self.files())

    def read(self, names: Sequence[str] | None = None) -> pa.Table:
        """Return all rows, or some of their columns, in the order of their keys."""
        schema = self.schema
        if unknown := [name for name in names or () if name not in schema.names]:
            there = ", ".join(schema.names)
            raise ConfigError(
                f"{self.directory}: its runs have no column {unknown[0]}; they have {there}"
            )
        if names is not None:
            schema = pa.schema([schema.field(name) for name in names])
        tables = [schema.remove_metadata().empty_table(), *self.runs.batches(names)]
        return pa.concat_tables(tables).cast(schema)

    def batches(self, names: Sequence[str] | None = None) -> Iterator[pa.RecordBatch]:
        """Yield the same rows in the same order, in pieces of bounded size."""
        for piece in self.runs.batches(names):
            yield from piece.to_batches()

    @cached_property
    def plan(self) -> Plan:
        """What its runs can be computed again from, unless its table of bodies has changed."""
        # Numba, which most readers of a sweep do without.
        from rattlesweep.sweeps.plan import make_plan

        base = self.manifest["base"] or "."
        if (self.directory / getattr(self.config.bodies, "path", "..none")).exists():
            base = self.directory  # a directory may have been moved with its table
        plan = make_plan(self.config, Path(base)).with_cases(self.cases)
        if sweep_hash(plan) != self.hash:
            raise ConfigError(f"{self.directory}: the table of bodies of its runs has changed")
        return plan


def sweep_hash(plan: Plan) -> str:
    """Return the hash of what determines a run with a given key: the physical part of the config,
    and the table of bodies.
    """
    text = f"{physics_hash(plan.config)} {getattr(plan.source, 'content_hash', '')}"
    return hashlib.sha256(text.encode()).hexdigest()


def open_stored(directory: Path | str) -> Stored:
    """Open an output directory; raise a ConfigError if it is none."""
    directory = Path(directory)
    path = directory / MANIFEST
    try:
        data = json.loads(path.read_bytes())
        if data["format"] != FORMAT:
            raise ValueError(f"its format is {data['format']}, and this version reads {FORMAT}")
        extra = tuple(
            pa.field(
                part["name"], pa.type_for_alias(part["type"]), part["nullable"],
                {"unit": part["unit"], "description": part["description"]},
            )
            for part in data["columns"]
        )  # fmt: skip
        cases = tuple(Case.load(case) for case in data["cases"])
        config = parse_config(data["config"])
        samples, key = int(data["samples"]), str(data["config_hash"])
        if [case.index for case in cases] != list(range(len(cases))) or samples < 1:
            raise ValueError("its cases are not numbered")
        return Stored(directory, data, config, cases, extra, samples, key)
    except (FileNotFoundError, NotADirectoryError):
        what = "has no manifest.json" if directory.is_dir() else "there is no such directory"
        raise ConfigError(f"{directory} is not an output directory: {what}") from None
    except OSError as error:
        raise OutputError(f"cannot read {path}: {reason(error)}") from error
    except (ValueError, TypeError, KeyError, AttributeError) as error:
        raise DamagedError(
            f"{path} is damaged or of another version ({reason(error)[:100]}); move it away, and "
            "`rattlesweep run` with the same config makes it again"
        ) from error


def examine(plan: Plan, directory: Path) -> tuple[Stored | None, tuple[Case, ...]]:
    """Refuse a directory in which a plan cannot go on.

    Return the sweep that is there, None if its manifest has yet to be written, and the plan's cases
    as they are numbered there.
    """
    ours = sweep_hash(plan)
    if not (directory / MANIFEST).exists():
        check_empty(directory)  # or its manifest is lost
        Runs(directory).find(plan.cases, plan.samples, ours, plan.schema)
        return None, plan.cases
    there = open_stored(directory)
    try:
        if there.hash != ours:
            what = differing_keys(there.config, plan.config)
            raise ConfigError(f"holds another sweep ({what}); give another output, or --fresh")
        if plan.samples < there.samples:
            held = f"holds a sweep of {there.samples} samples a case"
            raise ConfigError(
                f"{held}, and the config asks for {plan.samples}; a sweep can only grow"
            )
        return there, grown(there.cases, plan.cases)
    except ConfigError as error:
        raise ConfigError(f"{directory}: {error}") from None


def differing_keys(one: Config, other: Config) -> str:
    """Return in which keys two sweeps differ, with both values."""
    parts = (fixed_part(config) for config in (one, other))
    return "; ".join(differences(*parts)[:3]) or "the table of bodies has changed"


def begin(plan: Plan, directory: Path, base: Path | None, shard: str | None) -> Stored:
    """Make a directory, which this process holds, one of a plan, and return it.

    The manifest is written where there is none, and again where the sweep grows or, unless for a
    shard, its config changes in what no run depends on.
    """
    with explained(f"cannot write in {directory}"):
        (directory / FOLDER).mkdir(exist_ok=True)
    there, cases = examine(plan, directory)
    data = {
        "format": FORMAT,
        "name": plan.config.name,
        "config": resolved(plan.config),
        "config_hash": sweep_hash(plan),
        "base": None if base is None else str(base),
        "cases": [case.dump() for case in cases],
        "samples": plan.samples,
        "columns": [
            {"name": column.name, "type": str(column.type), "nullable": column.nullable}
            | {key.decode(): text.decode() for key, text in (column.metadata or {}).items()}
            for column in plan.extra
        ],
        "versions": versions(),
        "machine": machine(),
        "command": command_line(),
        "started": now(),
        "written": now(),
    }
    if there is not None:
        keys = ("cases", "samples") if shard else ("cases", "samples", "config")
        if all(data[key] == there.manifest[key] for key in keys):
            return there
        # A shard that works on has the smaller sweep in mind, and would leave its summary.
        if others := at_work(directory, shard) if shard else []:
            raise OutputError(
                f"{directory}: {others[0]} is at work; the sweep can grow when it has ended"
            )
        data["started"] = there.manifest["started"]
    remove_summary(directory)  # it is of the smaller sweep
    write_manifest(directory, data)
    return open_stored(directory)


def write_manifest(directory: Path, data: dict[str, Any]) -> None:
    """Put ``manifest.json`` in place, whole."""
    text = json.dumps(data, indent=2, allow_nan=False)
    replace_file(directory / MANIFEST, text.encode() + b"\n")


def check_empty(directory: Path) -> None:
    """Raise a ConfigError if a directory holds files and no sweep has worked there."""
    if directory.is_file():
        raise ConfigError(f"{directory}: is a file; give the path of a directory")
    if not directory.exists() or (directory / LOCKS).is_dir():
        return
    with explained(f"cannot read {directory}"):
        names = sorted(path.name for path in directory.iterdir())
    # Bodies from memory are kept before the sweep begins.
    if foreign := [name for name in names if not name.startswith((".", "bodies-"))]:
        raise ConfigError(
            f"{directory}: holds other files, such as {foreign[0]}; give an empty or new directory"
        )


def start_over(directory: Path) -> None:
    """Remove a sweep, its rows first, so that a kill leaves a sweep and no foreign files."""
    runs = Runs(directory)
    with explained(f"cannot remove the runs of {directory}"):
        for path in [*runs.files(), *runs.folder.glob("*.damaged")]:
            path.unlink()
        for name in (SUMMARY, MANIFEST):
            (directory / name).unlink(missing_ok=True)


def remove_summary(directory: Path) -> None:
    """Remove the summary where rows have come or gone."""
    with explained(f"cannot remove {directory / SUMMARY}"):
        (directory / SUMMARY).unlink(missing_ok=True)
