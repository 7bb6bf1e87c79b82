"""Duration of commands with an empty and with a filled cache of kernels.

    python benchmarks/cold.py [COMMAND]... [--repeats 3] [--only cold|warm]

Each cold measurement has its own cache directory, and the warm one after it uses the
same.  Every command writes to an empty directory.  On a busy machine, compare processor
times (of the command and its child processes) instead of wall times.  The table has
medians and the number of compiled files.
"""

from __future__ import annotations

import json
import os
import resource
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass, field
from pathlib import Path

import click

ROOT = Path(__file__).resolve().parent.parent
RATTLESWEEP = [sys.executable, "-m", "rattlesweep"]
LAUNCH = ["--preset", "GH", "--n-i", "-0.1", "--t-end", "1500"]
COMMANDS: dict[str, list[str]] = {
    "import": [sys.executable, "-c", "import rattlesweep"],
    "help": [*RATTLESWEEP, "--help"],
    "run": [
        *RATTLESWEEP,
        "run",
        str(ROOT / "configs" / "quickstart.yaml"),
        "--output",
        "out",
    ],
    "trajectory": [*RATTLESWEEP, "trajectory", *LAUNCH, "--figure", "spin.svg"],
    "tradeoff": [*RATTLESWEEP, "tradeoff", "--quick", "--output", "out"],
    "paper": [*RATTLESWEEP, "paper", "--quick", "--output", "out"],
}
# Wanted seconds, cold and warm, on an idle machine with two Zen 3 cores.
GOALS: dict[str, tuple[float | None, float | None]] = {
    "run": (15, None),
    "trajectory": (15, None),
    "paper": (60, 15),
}


@dataclass
class Measured:
    """Times of the repeats of a command."""

    wall: list[float] = field(default_factory=list)
    cpu: list[float] = field(default_factory=list)
    kernels: int = 0


def spent() -> float:
    """Return the processor time of all child processes that have ended."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def measure(command: list[str], cache: Path, found: Measured) -> None:
    """Run a command once in a new directory."""
    env = os.environ | {"XDG_CACHE_HOME": str(cache)}
    env.pop("NUMBA_CACHE_DIR", None)
    env["PYTHONPATH"] = os.pathsep.join(
        filter(None, [str(ROOT), env.get("PYTHONPATH")])
    )
    with tempfile.TemporaryDirectory() as place:
        before, begin = spent(), time.perf_counter()
        done = subprocess.run(
            command, cwd=place, env=env, capture_output=True, check=False
        )
        found.wall.append(time.perf_counter() - begin)
        found.cpu.append(spent() - before)
    if done.returncode:
        raise click.ClickException(
            f"{' '.join(command)}: {done.stderr.decode(errors='replace')}"
        )
    found.kernels = len(list(cache.rglob("*.kernel")))


def shown(found: Measured, goal: float | None) -> str:
    """Return medians as text, with a mark for whether the wall time meets its goal."""
    if not found.wall:
        return f"{'':>24}"
    wall, cpu = statistics.median(found.wall), statistics.median(found.cpu)
    mark = "" if goal is None else f"{' <' if wall < goal else ' >'} {goal:.0f}"
    return f"{wall:9.2f}{mark:5}{cpu:10.2f}"


@click.command()
@click.argument(
    "names", metavar="[COMMAND]...", type=click.Choice(list(COMMANDS)), nargs=-1
)
@click.option("--repeats", default=3, show_default=True)
@click.option(
    "--only", type=click.Choice(["cold", "warm"]), help="Only one half of the table."
)
@click.option(
    "--json", "file", type=click.Path(path_type=Path), help="All measurements, too."
)
def main(
    names: tuple[str, ...], repeats: int, only: str | None, file: Path | None
) -> None:
    """Measure COMMANDs, by default all of them."""
    from kernel import heading

    heading()
    load = os.getloadavg()[0] if hasattr(os, "getloadavg") else float("nan")
    click.echo(f"medians of {repeats}, in seconds; load at the start {load:.1f}\n")
    click.echo(
        f"{'':12}{'cold':>9}{'':5}{'CPU':>10}{'kernels':>9}{'warm':>9}{'':5}{'CPU':>10}"
    )
    results = {}
    with tempfile.TemporaryDirectory() as home:
        for name in names or COMMANDS:
            cold, warm = Measured(), Measured()
            cache = Path(home) / name
            for _ in range(1 if only == "warm" else repeats):
                shutil.rmtree(cache, ignore_errors=True)
                cache.mkdir(mode=0o700)
                measure(COMMANDS[name], cache, cold)
            for _ in range(0 if only == "cold" else repeats):
                measure(COMMANDS[name], cache, warm)
            wanted = GOALS.get(name, (None, None))
            click.echo(
                f"{name:12}{shown(cold, wanted[0])}{cold.kernels:9}{shown(warm, wanted[1])}"
            )
            results[name] = {"cold": vars(cold), "warm": vars(warm)}
    if file is not None:
        file.write_text(json.dumps(results, indent=1) + "\n")


if __name__ == "__main__":
    main()
