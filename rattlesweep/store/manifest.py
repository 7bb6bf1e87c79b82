"""From a plan to the directory that holds its runs, and back.

The manifest describes a sweep as far as anyone needs to run it again.
"""

import hashlib
from dataclasses import replace
from pathlib import Path

from rattlesweep.config.read import differences, fixed_part, physics_hash, resolved
from rattlesweep.design.plan import (
    Plan,
    make_plan,
)
from rattlesweep.rows.arrow import unit_and_meaning
from rattlesweep.store.locks import FOLDER, LOCKS, free_locks, names_of_locks
from rattlesweep.store.provenance import command_line, machine, now, versions
from rattlesweep.store.rows import FORMAT, MANIFEST, Stored, open_stored
from rattlesweep.system.files import explained
from rattlesweep.words.errors import ConfigError, OutputError


def stored_plan(stored: Stored) -> Plan:
    """Return the plan from which stored runs can be computed again."""
    base = stored.manifest["base"] or "."
    path = getattr(stored.config.bodies, "path", None)
    if isinstance(path, str) and (stored.directory / path).exists():
        base = stored.directory  # a directory may have been moved with its table
    plan = replace(make_plan(stored.config, Path(base)), cases=stored.cases)
    check_same(stored, _describe(plan, stored.directory))
    config = plan.config.model_copy(update={"classify": stored.thresholds})
    return replace(plan, config=config)


def begin_sweep(
    plan: Plan, directory: Path, base: Path | None, shard: str | None
) -> Stored:
    """Begin or grow the sweep of a plan in a directory that this process holds."""
    with explained(f"cannot write in {directory}"):
        (directory / FOLDER).mkdir(exist_ok=True)
    stored, grown = examine(plan, directory, base)
    if stored is not None:
        keys = ["cases", "samples"]
        if shard is None:
            keys.append("config")  # of which the name and thresholds may have changed
        if all(grown.manifest[key] == stored.manifest[key] for key in keys):
            return stored
        # Shards that are at work know only the smaller sweep, whose summary they would
        # write.
        busy = None
        if shard is not None:
            busy = free_locks(
                directory, filter(shard.__ne__, names_of_locks(directory))
            )
        if busy is not None:
            raise OutputError(
                f"{directory}: {busy} is at work; the sweep can grow when it has ended"
            )
        grown.manifest["started"] = stored.manifest["started"]
    grown.drop_summary()
    grown.write_manifest()
    return grown


def examine(
    plan: Plan, directory: Path, base: Path | None = None
) -> tuple[Stored | None, Stored]:
    """Return the sweep in a directory, None without one, and what it must grow into."""
    wanted = _describe(plan, directory, base)
    if not (directory / MANIFEST).exists():
        check_empty(directory)
        wanted.find()  # there are rows if a manifest was lost
        return None, wanted
    stored = open_stored(directory)
    check_same(stored, wanted)
    wanted_cases = set(plan.cases)
    lost = [case for case in stored.cases if case not in wanted_cases]
    excess = ""
    if lost:
        excess = f"runs with {lost[0]}, which the config lacks"
    elif plan.samples < stored.samples:
        excess = f"{stored.samples} samples a case, more than the config asks for"
    if excess:
        raise ConfigError(f"{directory}: holds {excess}; a sweep can only grow")
    # Cases keep their numbers, and new ones follow.
    cases = list(stored.cases)
    known = set(stored.cases)
    for case in plan.cases:
        if case not in known:
            cases.append(replace(case, index=len(cases)))
    return stored, _describe(replace(plan, cases=tuple(cases)), directory, base)


def _describe(plan: Plan, directory: Path, base: Path | None = None) -> Stored:
    """Return the sweep of a plan as a directory would hold it; nothing is written."""
    table_hash = getattr(plan.source, "content_hash", "")
    text = f"{physics_hash(plan.config)} {table_hash}"
    key = hashlib.sha256(text.encode()).hexdigest()
    columns = []
    for column in plan.extra:
        about = unit_and_meaning(column)
        columns.append([column.name, str(column.type), column.nullable, *about])
    manifest: dict[str, object] = {
        "format": FORMAT,
        "name": plan.config.name,
        "config": resolved(plan.config),
        "config_hash": key,
        "base": None if base is None else str(base),
        "cases": [case.dump() for case in plan.cases],
        "samples": plan.samples,
        "columns": columns,
        "versions": versions(),
        "machine": machine(),
        "command": command_line(),
        "started": now(),
        "written": now(),
    }
    return Stored(
        config=plan.config,
        cases=plan.cases,
        samples=plan.samples,
        extra=plan.extra,
        directory=directory,
        manifest=manifest,
        hash=key,
    )


def check_same(stored: Stored, wanted: Stored) -> None:
    """Raise a ConfigError that says in what a stored sweep differs from another."""
    if stored.hash != wanted.hash:
        differing = differences(fixed_part(stored.config), fixed_part(wanted.config))
        what = "; ".join(differing[:3]) or "the table of bodies has changed"
        raise ConfigError(
            f"{stored.directory}: holds another sweep ({what}); give another output"
        )
    if stored.schema.names != wanted.schema.names:
        raise ConfigError(
            f"{stored.directory}: another version of rattlesweep wrote its runs, with "
            "other columns; repeat them in another directory"
        )


def check_empty(directory: Path) -> None:
    """Raise a ConfigError if a directory holds files, but for those of a sweep."""
    if directory.is_file():
        raise ConfigError(f"{directory}: is a file; give the path of a directory")
    if not directory.exists() or (directory / LOCKS).is_dir():
        return
    with explained(f"cannot read {directory}"):
        names = sorted(path.name for path in directory.iterdir())
    # Bodies of a DataFrame are written there before the sweep begins.
    foreign = [name for name in names if not name.startswith((".", "bodies-"))]
    if foreign:
        raise ConfigError(
            f"{directory}: holds other files, such as {foreign[0]}; give an empty or "
            "new directory"
        )
