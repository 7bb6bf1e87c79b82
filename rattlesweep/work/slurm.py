"""The script of a Slurm job array that runs a sweep, one shard per task."""

import os
import re
import shlex
import sys
import sysconfig
from collections.abc import Sequence
from importlib.metadata import version
from importlib.resources import files
from pathlib import Path

from rattlesweep.design.plan import Plan
from rattlesweep.words.errors import ConfigError

_MARGIN = 300  # seconds before the limit at which a task stops
MARGIN_SHARE = 0.25  # of the limit, if that is less
SHORTEST = 120  # seconds that a limit may be
# What a task does that is done; the last one finds no run missing.
_CHECK = """\
if [[ $code -eq 0 || $code -eq 3 ]]; then
    missing=0
    "${program[@]}" status "$output" --complete >/dev/null 2>&1 || missing=$?
    if ((missing != 75)); then
        "${program[@]}" verify "$output" --complete || ((code)) || code=1
    fi
fi
"""
_LIMIT = re.compile(
    r"(?:(?P<days>\d{1,4})-)?(?P<hours>\d{1,6}):(?P<minutes>\d\d):(?P<seconds>\d\d)"
    r"|(?P<alone>\d{1,6})"
)


def limit_of(text: str) -> int:
    """Read a limit as Slurm does and return it in seconds.

    It is ``[days-]hours:minutes:seconds`` or a number of minutes.
    """
    match = _LIMIT.fullmatch(text.strip())
    if not match:
        raise ValueError(
            "is no time limit; write it as in 4:00:00, 90 (minutes) or 2-12:00:00"
        )
    limit = {name: int(number or 0) for name, number in match.groupdict().items()}
    minutes = limit["minutes"] + limit["alone"]
    total = 86400 * limit["days"] + 3600 * limit["hours"] + 60 * minutes
    total += limit["seconds"]
    if total < SHORTEST:
        raise ValueError("is too short; give at least 2 minutes")
    return total


def program() -> list[str]:
    """Return the program and first arguments that run this version again."""
    places = [Path(sys.argv[0]).absolute()]
    if sys.executable:
        places.append(Path(sys.executable).with_name("rattlesweep"))
    # Where `pip install --user` puts it.
    places.append(Path(sysconfig.get_path("scripts", f"{os.name}_user"), "rattlesweep"))
    for place in places:
        if (
            place.name == "rattlesweep"
            and os.access(place, os.X_OK)
            and place.is_file()
        ):
            return [str(place)]
    return [sys.executable or "python3", "-P", "-m", "rattlesweep"]


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
    """Return the script of a job array; with `own`, shards write to ``OUTPUT-I``."""
    name = plan.config.name
    where = Path.cwd()
    quote = shlex.quote
    if any("\n" in f"{text}" for text in (name, config, output, where, *overrides)):
        what = "a name, path or override with a line break cannot stand in a script"
        raise ConfigError(what)
    if not re.fullmatch(r"(?i)\d+([KMGT]B?)?", memory):
        raise ConfigError(f"--mem {memory}: is not a size of memory; write it as in 4G")
    if partition is not None and not re.fullmatch(r"[\w.,+-]+", partition):
        raise ConfigError(f"--partition {partition}: is not the name of a partition")
    # Slurm sends its warning halfway between the task's own stop and the limit.
    margin = round(min(_MARGIN, MARGIN_SHARE * limit))
    target = quote(f"{output}")
    finish = f"verify {target} --complete"
    directory = target
    check = _CHECK
    ending = "The last one to end checks all:"
    if own:
        check = ""
        ending = "When all have ended:"
        shards_of = f"{{0..{shards - 1}}}" if shards > 1 else "0"
        merged = quote(f"{output}-merged")
        finish = f"merge {target}-{shards_of} --output {merged}"
        directory = f'{target}"-$index"'
    options = f"#SBATCH --mem={memory}\n"
    if partition is not None:
        options += f"#SBATCH --partition={partition}\n"
    values = {
        "NAME": re.sub(r"[^\w.-]+", "-", name).strip("-.") or "sweep",
        "LAST": shards - 1,
        "CPUS": cpus,
        "TIME": f"{limit // 3600}:{limit // 60 % 60:02}:{limit % 60:02}",
        "WARNING": margin // 2,
        "MORE": options,
        "ABOUT": f"{plan.runs} runs in {shards} shards.",
        "ENDING": ending,
        "FINISH": f"rattlesweep {finish}",
        "CHECK": check,
        "VERSION": version("rattlesweep"),
        "PROGRAM": shlex.join(program()),
        "WHERE": quote(f"{where}"),
        "CONFIG": quote(f"{config}"),
        "OUTPUT": directory,
        "SETS": "".join(f" --set {quote(text)}" for text in overrides),
        "SHARDS": shards,
        "SECONDS": limit - margin,
        "RESTARTS": restarts,
    }
    template = files(__package__).joinpath("slurm_array.sh").read_text(encoding="utf-8")
    return re.sub(r"@(\w+)@", lambda match: str(values[match[1]]), template)
