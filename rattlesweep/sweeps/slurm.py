"""A Slurm job array that does a sweep, one shard per task."""

from __future__ import annotations

import re
import shlex
import sys
from collections.abc import Sequence
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING

from rattlesweep.errors import ConfigError
from rattlesweep.sweeps.provenance import package_version

if TYPE_CHECKING:
    from rattlesweep.sweeps.plan import Plan

MARGIN, MARGIN_SHARE = 300, 0.25  # seconds, or share of the limit if that is less


def limit_of(text: str) -> int:
    """Return the seconds of Slurm's ``[days-]hours:minutes:seconds``, or of minutes alone."""
    match = re.fullmatch(r"(?:(\d{1,4})-)?(\d{1,6}):(\d\d):(\d\d)|(\d{1,6})", text.strip())
    if not match:
        raise ValueError("is no time limit; write it as in 4:00:00, 90 (minutes) or 2-12:00:00")
    days, hours, minutes, seconds, alone = (int(part or 0) for part in match.groups())
    total = 86400 * days + 3600 * hours + 60 * (minutes + alone) + seconds
    if total < 120:
        raise ValueError("is too short; give at least 2 minutes")
    return total


def job_script(
    plan: Plan, config: Path, output: Path, overrides: Sequence[str], *, shards: int, own: bool,
    limit: int, cpus: int, memory: str, partition: str | None, restarts: int,
) -> str:  # fmt: skip
    """Return the script of a job array; with `own`, each shard writes to ``OUTPUT-I``."""
    name, where, quote = plan.config.name, Path.cwd(), shlex.quote
    if any("\n" in f"{text}" for text in (name, config, output, where, *overrides)):
        raise ConfigError("a name, path or override with a line break cannot stand in a script")
    if not re.fullmatch(r"(?i)\d+([KMGT]B?)?", memory):
        raise ConfigError(f"--mem {memory}: is not a size of memory; write it as in 4G")
    if partition is not None and not re.fullmatch(r"[\w.,+-]+", partition):
        raise ConfigError(f"--partition {partition}: is not the name of a partition")
    # A task stops by itself before its limit; Slurm warns after half of that margin.
    margin = round(min(MARGIN, MARGIN_SHARE * limit))
    target, parts = quote(f"{output}"), f"{{0..{shards - 1}}}" if shards > 1 else "0"
    merge = f"merge {target}-{parts} --output {quote(f'{output}-merged')}"
    more = "" if partition is None else f"#SBATCH --partition={partition}\n"
    values = {
        "NAME": re.sub(r"[^\w.-]+", "-", name).strip("-.") or "sweep",
        "LAST": shards - 1,
        "CPUS": cpus,
        "TIME": f"{limit // 3600}:{limit // 60 % 60:02}:{limit % 60:02}",
        "WARNING": margin // 2,
        "MORE": f"#SBATCH --mem={memory}\n{more}",
        "ABOUT": f"{plan.runs} runs in {shards} shards.",
        "FINISH": f"rattlesweep {merge if own else f'verify {target}'}",
        "VERSION": package_version(),
        "PROGRAM": quote(f"{Path(sys.executable).with_name('rattlesweep')}"),
        "WHERE": quote(f"{where}"),
        "CONFIG": quote(f"{config}"),
        "OUTPUT": f'{target}"-$index"' if own else target,
        "SETS": "".join(f" --set {quote(text)}" for text in overrides),
        "SHARDS": shards,
        "SECONDS": limit - margin,
        "RESTARTS": restarts,
    }
    template = files(__package__).joinpath("slurm_array.sh").read_text(encoding="utf-8")
    return re.sub(r"@(\w+)@", lambda match: str(values[match[1]]), template)
