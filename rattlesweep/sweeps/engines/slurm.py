"""A Slurm job array that does a sweep, a share a task."""

from __future__ import annotations

import math
import re
import shlex
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path

from rattlesweep.errors import ConfigError

# Seconds before its time limit at which a task stops by itself, at most, and the share of a short
# limit. Slurm's own warning comes after half of that, up to a minute early.
MARGIN, MARGIN_SHARE = 300, 0.25
SHORTEST = 120
# Tasks of an array that Slurm takes unless told otherwise.
MOST_SHARDS = 1001


@dataclass(frozen=True)
class ArrayJob:
    """What a job script is made of.

    Attributes
    ----------
    name : str
        Of the sweep.
    version : str
        Of rattlesweep; the script refuses to run with another.
    program : Path
        The command `rattlesweep` of the environment that writes the script.
    directory, config, output : Path
        Absolute: where the command was given, the config, the output.
    overrides : tuple of str
        Those of ``--set``.
    runs, blocks, shards : int
    own : bool
        Whether each share has a directory of its own, ``OUTPUT-I``.
    limit : int
        Seconds a task may take.
    cpus : int
    memory : int
        Bytes.
    partition : str or None
    restarts : int
        How often a task puts itself into the queue again.
    expected : float or None
        Seconds of the longest share on the machine that writes the script.
    """

    name: str
    version: str
    program: Path
    directory: Path
    config: Path
    output: Path
    overrides: tuple[str, ...]
    runs: int
    blocks: int
    shards: int
    own: bool
    limit: int
    cpus: int
    memory: int
    partition: str | None
    restarts: int
    expected: float | None = None


def limit_of(text: str) -> int:
    """Seconds of a time limit as Slurm writes it.

    ``minutes``, ``minutes:seconds``, ``hours:minutes:seconds``, ``days-hours``,
    ``days-hours:minutes`` or ``days-hours:minutes:seconds``.

    Raises
    ------
    ValueError
        It is something else, or too short.
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

    Raises
    ------
    ValueError
        It is something else.
    """
    match = re.fullmatch(r"(\d{1,9})\s*([KMGT]?)B?", text.strip(), re.IGNORECASE)
    if not match or not int(match[1]):
        raise ValueError("is no size of memory; write it as in 4G or 800M")
    power: int = " KMGT".index(match[2].upper() or "M")
    return int(match[1]) << (10 * power)


def margin_of(limit: int) -> int:
    """Seconds before the limit at which a task stops by itself."""
    return round(min(MARGIN, MARGIN_SHARE * limit))


def job_script(job: ArrayJob) -> str:
    """Text of the script.

    Raises
    ------
    ConfigError
        A value has a line break, which a script's head cannot hold.
    """
    texts = (job.name, str(job.config), str(job.output), str(job.directory), job.partition or "")
    if any("\n" in text or "\r" in text for text in (*texts, *job.overrides)):
        raise ConfigError("a name, path or override with a line break cannot stand in a script")
    if job.partition is not None and not re.fullmatch(r"[\w.,+-]+", job.partition):
        raise ConfigError(f"--partition {job.partition}: is no name of a partition")
    margin = margin_of(job.limit)
    safe = re.sub(r"[^\w.-]+", "-", job.name).strip("-.") or "sweep"
    head = [
        f"--job-name={safe}",
        f"--array=0-{job.shards - 1}",
        "--ntasks=1",
        f"--cpus-per-task={job.cpus}",
        f"--mem={math.ceil(job.memory / 1024**2)}M",
        f"--time={_clock(job.limit)}",
        f"--signal=B:USR1@{margin // 2}",
        "--requeue",
        "--open-mode=append",
        f"--output={safe}-%A_%a.log",
    ]
    if job.partition is not None:
        head.append(f"--partition={job.partition}")
    target = f'{_quoted(job.output)}"-$index"' if job.own else _quoted(job.output)
    sets = " ".join(f"--set {_quoted(text)}" for text in job.overrides)
    about = f"# {job.runs} runs in {job.blocks} blocks, in {job.shards} shares"
    if job.expected is not None:
        about += f"; the longest takes about {_clock(round(job.expected))} (h:mm:ss)\n"
        about += "# on the machine that wrote this, with up to as many threads as it has"
    values = {
        "DIRECTIVES": "\n".join(f"#SBATCH {line}" for line in head),
        "ABOUT": about + ".",
        "VERSION": job.version,
        "PROGRAM": _quoted(job.program),
        "WHERE": _quoted(job.directory),
        "CONFIG": _quoted(job.config),
        "OUTPUT": target,
        "SETS": f" {sets}" if sets else "",
        "SHARDS": str(job.shards),
        "SECONDS": str(job.limit - margin),
        "RESTARTS": str(job.restarts),
        "FINISH": _finish(job),
    }
    template = files(__package__).joinpath("slurm_array.sh").read_text(encoding="utf-8")
    return re.sub(r"@(\w+)@", lambda match: values[match[1]], template)


def _finish(job: ArrayJob) -> str:
    output, merged = _quoted(job.output), _quoted(f"{job.output}-merged")
    if job.own:
        parts = f"{output}-{{0..{job.shards - 1}}}" if job.shards > 1 else f"{output}-0"
        return f"#   rattlesweep merge {parts} --output {merged}\n#   rattlesweep verify {merged}"
    return (
        f"#   rattlesweep verify {output}\n"
        f"#   rattlesweep merge {output} --output {merged}    # fewer, larger files"
    )


def _quoted(text: str | Path) -> str:
    return shlex.quote(str(text))


def _clock(seconds: int) -> str:
    days, rest = divmod(seconds, 86400)
    clock = f"{rest // 3600:02d}:{rest % 3600 // 60:02d}:{rest % 60:02d}"
    return f"{days}-{clock}" if days else clock
