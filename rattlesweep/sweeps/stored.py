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
from rattlesweep.sweeps import columns
from rattlesweep.sweeps.cases import Case, grown, recovered
from rattlesweep.sweeps.columns import runs_schema
from rattlesweep.sweeps.config.read import (
    differences,
    fixed_part,
    override_config,
    physics_hash,
    resolved,
)
from rattlesweep.sweeps.config.schema import Classify, Config
from rattlesweep.sweeps.files import explained, reason, replace_file
from rattlesweep.sweeps.locks import FOLDER as LOCKS
from rattlesweep.sweeps.locks import manifest_lock, others_at_work
from rattlesweep.sweeps.provenance import command_line, machine, now, versions
from rattlesweep.sweeps.rows import FOLDER, Runs

if TYPE_CHECKING:
    from rattlesweep.sweeps.plan import Plan

MANIFEST, SUMMARY = "manifest.json", "summary.parquet"
FORMAT = 3


@dataclass(frozen=True)
class Stored:
    """An output directory.

    Attributes
    ----------
    directory : Path
    manifest : dict
        ``manifest.json`` as it is.
    config : Config
        Its config, with all defaults filled in.
    cases : tuple of Case
    extra : tuple of pa.Field
        Columns that the bodies and launches bring along.
    """

    directory: Path
    manifest: dict[str, Any]
    config: Config
    cases: tuple[Case, ...]
    extra: tuple[pa.Field, ...]

    @property
    def samples(self) -> int:
        """Number of samples of each case."""
        return int(self.manifest["samples"])

    @property
    def hash(self) -> str:
        """Hash of what determines the numbers of a run with a given key."""
        return str(self.manifest["config_hash"])

    @property
    def base(self) -> Path | None:
        """Directory of the config file, where the path of a table begins."""
        return None if self.manifest.get("base") is None else Path(self.manifest["base"])

    @cached_property
    def schema(self) -> pa.Schema:
        """Arrow schema of the runs, with `unit` and `description` in each field's metadata."""
        return runs_schema(self.config.parts, self.config.model, self.extra)

    @property
    def thresholds(self) -> Classify:
        """Thresholds behind the types: those of ``rattlesweep classify``, else of the config."""
        typed = self.manifest.get("classified")
        if typed is None:
            return self.config.classify
        return self.config.classify.model_copy(update=typed)

    @property
    def typed(self) -> str:
        """The same as JSON, as each file of rows has it."""
        return self.thresholds.as_text

    @cached_property
    def runs(self) -> Runs:
        """The rows."""
        return Runs(self.directory)

    def files(self) -> list[Path]:
        """Return the files of the rows."""
        return self.runs.files()

    def count(self) -> int:
        """Return the number of rows on disk."""
        return self.runs.count()

    def read(self, names: Sequence[str] | None = None) -> pa.Table:
        """Return all rows in the order of their keys.

        Parameters
        ----------
        names : sequence of str, optional
            Columns; by default all.

        Raises
        ------
        ConfigError
            If there is no such column.
        OutputError
            If a file cannot be read or is damaged.
        """
        schema = self.schema
        if names is not None:
            if unknown := [name for name in names if name not in schema.names]:
                raise ConfigError(
                    f"{self.directory}: its runs have no column {unknown[0]}; they have "
                    f"{', '.join(schema.names)}"
                )
            schema = pa.schema([self.schema.field(name) for name in names])
        tables = [schema.remove_metadata().empty_table(), *self.runs.batches(names)]
        return pa.concat_tables(tables).cast(schema)

    def batches(self, names: Sequence[str] | None = None) -> Iterator[pa.RecordBatch]:
        """Yield the same rows in the same order, in pieces of bounded size."""
        for piece in self.runs.batches(names):
            yield from piece.to_batches()

    @cached_property
    def plan(self) -> Plan:
        """What its runs can be computed again from.

        Raises
        ------
        ConfigError
            If its table of bodies is gone or has changed.
        """
        # Numba, which most readers of a sweep do without.
        from rattlesweep.sweeps.plan import make_plan

        base = self.base
        path = getattr(self.config.bodies, "path", None)
        if path is not None and (self.directory / path).exists():
            base = self.directory  # a directory may have been moved with its table
        plan = make_plan(self.config, base).with_cases(self.cases)
        if sweep_hash(plan) != self.hash:
            raise ConfigError(
                f"{self.directory}: its table of bodies has changed, so its runs cannot be "
                "computed again"
            )
        return plan


def sweep_hash(plan: Plan) -> str:
    """Return the hash of what determines the numbers of a run with a given key.

    That is the physical part of the config, and the table of bodies.
    """
    from rattlesweep.sweeps.bodies.sources import content_hash

    text = f"{physics_hash(plan.config)} {content_hash(plan.source)}"
    return hashlib.sha256(text.encode()).hexdigest()


def open_stored(directory: Path | str) -> Stored:
    """Open an output directory.

    Raises
    ------
    ConfigError
        If the directory is not an output directory.
    DamagedError, OutputError
        If its manifest is damaged or cannot be read.
    """
    directory = Path(directory)
    path = directory / MANIFEST
    try:
        text = path.read_bytes()
    except (FileNotFoundError, NotADirectoryError):
        what = "has no manifest.json" if directory.is_dir() else "there is no such directory"
        raise ConfigError(f"{directory} is not an output directory: {what}") from None
    except OSError as error:
        raise OutputError(f"cannot read {path}: {reason(error)}") from error
    try:
        data = json.loads(text)
        other = data["format"] != FORMAT
        if not other:
            fields = tuple(_load_field(field) for field in data["columns"])
            cases = tuple(Case.load(case) for case in data["cases"])
            if [case.index for case in cases] != list(range(len(cases))) or data["samples"] < 1:
                raise ValueError("its cases are not numbered")
            config = override_config(data["config"], [])
            stored = Stored(directory, data, config, cases, fields)
            _ = stored.thresholds.as_text
    except (ValueError, TypeError, KeyError, AttributeError) as error:
        raise DamagedError(
            f"{path} is damaged ({reason(error)[:100]}); move it away, and `rattlesweep run` with "
            "the same config makes it again"
        ) from error
    if other:
        raise ConfigError(
            f"{directory} was written in format {data['format']} by another version of "
            f"rattlesweep; this one reads format {FORMAT}"
        )
    return stored


def examine(plan: Plan, directory: Path) -> tuple[Stored | None, tuple[Case, ...]]:
    """Compare a plan with what a directory holds.

    Returns
    -------
    held : Stored or None
        The sweep that is there; None if its manifest has yet to be written.
    cases : tuple of Case
        The plan's cases as they are numbered there.

    Raises
    ------
    ConfigError
        If the plan cannot go on there.
    OutputError
        If a file is not of this sweep, or cannot be read.
    """
    ours, runs = sweep_hash(plan), Runs(directory)
    try:
        if not (directory / MANIFEST).exists():
            if directory.exists() and not directory.is_dir():
                raise ConfigError("is a file; give the path of a directory")
            files = runs.files()
            if (foreign := foreign_name(directory)) and not files:
                raise ConfigError(
                    f"holds other files, such as {foreign}; give an empty or new directory"
                )
            if not files:
                return None, plan.cases
            cases = recovered(runs.cases(ours), plan.cases)
            runs.find(cases, plan.samples, ours, plan.schema, put_aside=False)
            return None, cases
        held = open_stored(directory)
        if held.hash != ours:
            theirs, mine = (fixed_part(resolved(c)) for c in (held.config, plan.config))
            what = "; ".join(differences(theirs, mine)[:3]) or "the table of bodies has changed"
            raise ConfigError(f"holds another sweep ({what}); give another output, or --fresh")
        if plan.samples < held.samples:
            raise ConfigError(
                f"holds a sweep of {held.samples} samples a case, and the config asks for "
                f"{plan.samples}; a sweep can only grow"
            )
        return held, grown(held.cases, plan.cases)
    except ConfigError as error:
        raise ConfigError([f"{directory}: {line}" for line in error.messages]) from None


def begin(plan: Plan, directory: Path, base: Path | None, shard: str | None) -> Stored:
    """Make a directory, which this process holds, one of a plan, and return it.

    The manifest is written where there is none, and again where the sweep grows.

    Raises
    ------
    ConfigError
        If the directory holds another sweep, or a larger one.
    OutputError
        If it cannot be written, or others compute runs of the smaller sweep.
    """
    with manifest_lock(directory):
        held, cases = examine(plan, directory)
        data = _manifest(plan.with_cases(cases), base)
        if held is not None:
            same = len(cases) == len(held.cases) and plan.samples == held.samples
            if same and _may_change(held.config) == _may_change(plan.config):
                return held
            if others_at_work(directory, shard):
                raise OutputError(
                    f"{directory}: other shards are at work on the smaller sweep; let it grow when "
                    "they have ended"
                )
            kept = ("started", "classified")
            data |= {key: held.manifest[key] for key in kept if key in held.manifest}
        with explained(f"cannot write in {directory / FOLDER}", folder=True):
            (directory / FOLDER).mkdir(exist_ok=True)
        remove_summary(directory)  # it is of the smaller sweep
        write_manifest(directory, data)
    return open_stored(directory)


OURS = ("runs", "sessions", MANIFEST, SUMMARY)


def foreign_name(directory: Path, ours: Sequence[str] = OURS) -> str | None:
    """Return the name of a file in a directory that is no part of a sweep; None if there is none,
    no such directory, or one in which a sweep has worked: figures may lie beside it.
    """
    if (directory / LOCKS).is_dir() or not directory.is_dir():
        return None
    with explained(f"cannot read {directory}"):
        names = sorted(p.name for p in directory.iterdir())
    # Bodies from memory are kept before the sweep begins.
    return next((n for n in names if n not in ours and not n.startswith((".", "bodies-"))), None)


def check_removable(directory: Path) -> None:
    """Raise a ConfigError if a directory holds files and no sweep has worked there."""
    with contextlib.suppress(ConfigError, DamagedError):
        open_stored(directory)
        return
    if foreign := foreign_name(directory, ours=()):
        raise ConfigError(
            f"{directory}: holds other files, such as {foreign}, and no sweep that --fresh could "
            "start over; give an empty or new directory"
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


def note_thresholds(stored: Stored, thresholds: Classify | None) -> None:
    """Write into the manifest by which thresholds the rows are typed; None: the config's."""
    typed = None if thresholds is None else thresholds.thresholds
    if stored.manifest.get("classified") == typed:
        return
    with manifest_lock(stored.directory):
        data = dict(open_stored(stored.directory).manifest)
        data.pop("classified", None)
        write_manifest(stored.directory, data | ({} if typed is None else {"classified": typed}))


def write_manifest(directory: Path, data: dict[str, Any]) -> None:
    """Put ``manifest.json`` in place, whole."""
    text = json.dumps(data, indent=2, allow_nan=False)
    replace_file(directory / MANIFEST, text.encode() + b"\n")


def _manifest(plan: Plan, base: Path | None) -> dict[str, Any]:
    return {
        "format": FORMAT,
        "name": plan.config.name,
        "config": resolved(plan.config),
        "config_hash": sweep_hash(plan),
        "base": None if base is None else str(base),
        "cases": [case.dump() for case in plan.cases],
        "samples": plan.samples,
        "columns": [_dump_field(field) for field in plan.extra],
        "versions": versions(),
        "machine": machine(),
        "command": command_line(),
        "started": now(),
        "written": now(),
    }


def _may_change(config: Config) -> dict[str, Any]:
    """Return the part of a config that may change while its sweep goes on."""
    data = resolved(config)
    kept = {key: data.get(key) for key in ("name", "classify", "stop")}
    limits = {"max_steps": data["integrator"]["max_steps"]}
    return kept | limits | {"refine": data["bodies"].get("refine")}


def _dump_field(field: pa.Field) -> dict[str, Any]:
    words = {key.decode(): text.decode() for key, text in (field.metadata or {}).items()}
    return {"name": field.name, "type": str(field.type), "nullable": field.nullable} | words


def _load_field(data: dict[str, Any]) -> pa.Field:
    kinds = {"double": columns.F64, "int64": columns.I64, "string": columns.TEXT}
    kind, nullable = kinds[data["type"]], bool(data["nullable"])
    return columns.field(data["name"], kind, data["unit"], data["description"], nullable=nullable)
