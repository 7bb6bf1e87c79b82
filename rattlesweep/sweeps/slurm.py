"""A Slurm job array that does a sweep, a share a task."""

from __future__ import annotations

import math
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

# Seconds before its time limit at which a task stops by itself, at most, and the share of a short
# limit. Slurm's own warning comes after half of that, up to a minute early.
MARGIN, MARGIN_SHARE = 300, 0.25
SHORTEST = 120
# Tasks of an array that Slurm takes unless told otherwise.
MOST_SHARDS = 1001


def limit_of(text: str) -> int:
    """Seconds of a time limit as Slurm writes it; a ValueError says what is wrong with it.

    ``minutes``, ``minutes:seconds``, ``hours:minutes:seconds``, ``days-hours``,
    ``days-hours:minutes`` or ``days-hours:minutes:seconds``.
    """
    match = re.fullmatch(r"(?:(\d{1,4})-)?(\d{1,6})(?::(\d{1,3}))?(?::(\d{1,3}))?", text.strip())
    if not match:
        raise ValueError(
            "is no time limit; write it as Slurm does, as in 4:00:00, 90 (minutes) or 2-12:00:00"
        )
    days, *rest = match.groups()
    parts = [int(part) for part in rest if part is not None]
    if days is not None or len(parts) == 3:
        parts += [0] * (3 - len(parts))
    else:
        parts = [0, *parts, *[0] * (2 - len(parts))]
    hours, minutes, seconds = parts
    total = 86400 * int(days or 0) + 3600 * hours + 60 * minutes + seconds
    if total < SHORTEST:
        raise ValueError(f"is too short; give at least {SHORTEST // 60} minutes")
    return total


def memory_of(text: str) -> int:
    """Bytes of a size of memory as Slurm writes it: ``4G``, ``800M``; megabytes without a unit.

    A ValueError says what is wrong with it.
    """
    match = re.fullmatch(r"(\d{1,9})\s*([KMGT]?)B?", text.strip(), re.IGNORECASE)
    if not match or not int(match[1]):
        raise ValueError("is no size of memory; write it as in 4G or 800M")
    power: int = " KMGT".index(match[2].upper() or "M")
    return int(match[1]) << (10 * power)


def margin_of(limit: int) -> int:
    """Seconds before the limit at which a task stops by itself."""
    return round(min(MARGIN, MARGIN_SHARE * limit))


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
    memory: int,
    partition: str | None,
    restarts: int,
    expected: float | None,
) -> str:
    """Text of the script, for the command of this environment in this directory.

    Parameters
    ----------
    config, output : Path
        Absolute.
    own : bool
        Whether each share has a directory of its own, ``OUTPUT-I``.
    limit, memory : int
        Seconds and bytes that a task may take.
    restarts : int
        How often a task puts itself into the queue again.
    expected : float or None
        Seconds of the longest share on this machine.
    """
    name, where = plan.config.name, Path.cwd()
    texts = (name, str(config), str(output), str(where), partition or "", *overrides)
    if any("\n" in text or "\r" in text for text in texts):
        raise ConfigError("a name, path or override with a line break cannot stand in a script")
    if partition is not None and not re.fullmatch(r"[\w.,+-]+", partition):
        raise ConfigError(f"--partition {partition}: is no name of a partition")
    margin = margin_of(limit)
    safe = re.sub(r"[^\w.-]+", "-", name).strip("-.") or "sweep"
    head = [
        f"--job-name={safe}",
        f"--array=0-{shards - 1}",
        "--ntasks=1",
        f"--cpus-per-task={cpus}",
        f"--mem={math.ceil(memory / 1024**2)}M",
        f"--time={_clock(limit)}",
        f"--signal=B:USR1@{margin // 2}",
        "--requeue",
        "--open-mode=append",
        f"--output={safe}-%A_%a.log",
    ]
    if partition is not None:
        head.append(f"--partition={partition}")
    about = f"# {plan.runs} runs in {plan.n_blocks} blocks, in {shards} shares"
    if expected is not None:
        about += f"; the longest takes about {_clock(round(expected))} (h:mm:ss)\n"
        about += "# on the machine that wrote this, with up to as many threads as it has"
    target, merged = _quoted(output), _quoted(f"{output}-merged")
    if own:
        parts = f"{target}-{{0..{shards - 1}}}" if shards > 1 else f"{target}-0"
        finish = f"#   rattlesweep merge {parts} --output {merged}\n#   rattlesweep verify {merged}"
    else:
        finish = (
            f"#   rattlesweep verify {target}\n"
            f"#   rattlesweep merge {target} --output {merged}    # fewer, larger files"
        )
    values = {
        "DIRECTIVES": "\n".join(f"#SBATCH {line}" for line in head),
        "ABOUT": about + ".",
        "VERSION": package_version(),
        "PROGRAM": _quoted(Path(sys.executable).with_name("rattlesweep")),
        "WHERE": _quoted(where),
        "CONFIG": _quoted(config),
        "OUTPUT": f'{target}"-$index"' if own else target,
        "SETS": "".join(f" --set {_quoted(text)}" for text in overrides),
        "SHARDS": str(shards),
        "SECONDS": str(limit - margin),
        "RESTARTS": str(restarts),
        "FINISH": finish,
    }
    template = files(__package__).joinpath("slurm_array.sh").read_text(encoding="utf-8")
    return re.sub(r"@(\w+)@", lambda match: values[match[1]], template)


def _quoted(text: str | Path) -> str:
    return shlex.quote(str(text))


def _clock(seconds: int) -> str:
    days, rest = divmod(seconds, 86400)
    clock = f"{rest // 3600:02d}:{rest % 3600 // 60:02d}:{rest % 60:02d}"
    return f"{days}-{clock}" if days else clock
