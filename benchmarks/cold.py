"""Duration of commands with an empty and with a filled cache of kernels.

    python benchmarks/cold.py [COMMAND]... [--repeats 3]

Each cold measurement has its own cache directory; the warm ones after it use the same.
Every command writes to an empty directory. On a busy machine, compare processor times
(of the command and its child processes) instead of wall times.
"""

from __future__ import annotations

import os
import resource
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import click
from machine import CONFIGS, ROOT, heading

COMMANDS = {
    "help": "--help",
    "run": f"run {CONFIGS / 'quickstart.yaml'} --output out",
    "trajectory": "trajectory --preset GH --n-i -0.1 --t-end 1500 --figure spin.svg",
    "tradeoff": "tradeoff --quick --output out",
    "paper": "paper --quick --output out",
}


def processor_time() -> float:
    """Return the processor time of all child processes that have ended."""
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime


def measure(command: str, cache: Path) -> tuple[float, float]:
    """Run a command once in a new directory; return wall and processor time."""
    environment = os.environ | {"XDG_CACHE_HOME": str(cache), "PYTHONPATH": str(ROOT)}
    environment.pop("NUMBA_CACHE_DIR", None)
    arguments = [sys.executable, "-m", "rattlesweep", *command.split()]
    with tempfile.TemporaryDirectory() as folder:
        processor = processor_time()
        begin = time.perf_counter()
        subprocess.run(
            arguments, cwd=folder, env=environment, capture_output=True, check=True
        )
        wall = time.perf_counter() - begin
    return wall, processor_time() - processor


def medians(times: list[tuple[float, float]]) -> str:
    """Return the medians of wall and processor times as text."""
    wall, processor = (statistics.median(values) for values in zip(*times, strict=True))
    return f"{wall:9.2f} ({processor:.2f})"


@click.command()
@click.argument(
    "names", metavar="[COMMAND]...", type=click.Choice(list(COMMANDS)), nargs=-1
)
@click.option("--repeats", default=3, show_default=True)
def main(names: tuple[str, ...], repeats: int) -> None:
    """Measure COMMANDs, by default all of them, in seconds."""
    click.echo(f"{heading()}\n{'':12}{'cold':>9}{'warm':>20}")
    with tempfile.TemporaryDirectory() as home:
        for name in names or COMMANDS:
            cache = Path(home) / name
            cold = []
            for _ in range(repeats):
                shutil.rmtree(cache, ignore_errors=True)
                cache.mkdir(mode=0o700)
                cold.append(measure(COMMANDS[name], cache))
            warm = [measure(COMMANDS[name], cache) for _ in range(repeats)]
            click.echo(f"{name:12}{medians(cold)}   {medians(warm)}")


if __name__ == "__main__":
    main()
