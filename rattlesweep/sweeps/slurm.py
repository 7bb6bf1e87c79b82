"""The script of a Slurm job array that runs a sweep, one shard per task."""

import re
import shlex
import sys
from collections.abc import Sequence
from importlib.metadata import version
from importlib.resources import files
from pathlib import Path

from rattlesweep.errors import ConfigError
from rattlesweep.sweeps.plan import Plan

MARGIN, MARGIN_SHARE = (
    300,
    0.25,
)  # seconds before the limit, or share of it if that is less


def limit_of(text: str) -> int:
    """Read a limit as Slurm does, ``[days-]hours:minutes:seconds`` or minutes, in
    seconds.
    """
    match = re.fullmatch(
        r"(?:(\d{1,4})-)?(\d{1,6}):(\d\d):(\d\d)|(\d{1,6})", text.strip()
    )
    if not match:
        raise ValueError(
            "is no time limit; write it as in 4:00:00, 90 (minutes) or 2-12:00:00"
        )
    days, hours, minutes, seconds, alone = (int(part or 0) for part in match.groups())
    total = 86400 * days + 3600 * hours + 60 * (minutes + alone) + seconds
    if total < 120:
        raise ValueError("is too short; give at least 2 minutes")
    return total


def job_script(
    plan: Plan,
    config: Path,
    output: Path,
    overrides: Sequence[str],
    *,
    shards: int,
    own: bool,
    limit: int,
    cpus: int,
    memory: str,
    partition: str | None,
    restarts: int,
) -> str:
    """Return the script of a job array; with `own`, each shard writes to
    ``OUTPUT-I``.
    """
    name, where, quote = plan.config.name, Path.cwd(), shlex.quote
    if any("\n" in f"{text}" for text in (name, config, output, where, *overrides)):
        raise ConfigError(
            "a name, path or override with a line break cannot stand in a script"
        )
    if not re.fullmatch(r"(?i)\d+([KMGT]B?)?", memory):
        raise ConfigError(f"--mem {memory}: is not a size of memory; write it as in 4G")
    if partition is not None and not re.fullmatch(r"[\w.,+-]+", partition):
        raise ConfigError(f"--partition {partition}: is not the name of a partition")
    # Slurm sends its warning halfway between the task's own stop and the limit.
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
        "VERSION": version("rattlesweep"),
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
