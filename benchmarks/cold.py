"""Duration of the README's commands, one after the other, from an empty cache on.

    python benchmarks/cold.py [--repeats 3] [--package FOLDER]

The first pass begins with an empty cache of kernels, and each command leaves what it
compiles to the next ones.  The second pass finds all kernels.  On a busy machine,
compare processor times (of a command and its child processes) instead of wall times.
``FOLDER`` is another checkout whose package is measured.
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

# A film of a law that no other command has.
STONE = """\
body:
  shape: half_ellipsoid
  length: 12 cm
  width: 3 cm
  height: 12 mm
  mass: 60 g
  skew: 3 deg
launch: {n_i: 60 rpm, omega_xy0: 10 rpm, psi: relevant}
dissipation: {pivot: 40 um}
"""
PYTHON = """\
import rattlesweep as rs

body = rs.Rattleback.gh()
runs = rs.simulate(body, n_i=[-0.1, 0.1], omega_xy0=0.01)
sweep = rs.load("out/quickstart")
sweep.read(["K_r", "n_i", "t_r"], where='type == "R" and t_r > 2 * t_rgh')
"""
COMMANDS = {
    "run": "-m rattlesweep run configs/quickstart.yaml",
    "plot": "-m rattlesweep plot out/quickstart",
    "show": "-m rattlesweep show --preset GH --output rattleback.html",
    "body": "-m rattlesweep body --preset GH --n-i -0.1",
    "trajectory": (
        "-m rattlesweep trajectory --preset GH --n-i 0.1 --t-end 250 --figure gh.svg"
    ),
    "fit": "-m rattlesweep fit configs/fit/stone.yaml configs/fit/data.csv",
    "verdict": "-m rattlesweep verdict configs/fit/stone.yaml --figure verdict.png",
    "film": "-m rattlesweep film stone.yaml",
    "Python": "first.py",
}
Times = tuple[float, float]  # of the wall and of processors


def processor_time() -> float:
    """Return the processor time of all child processes that have ended."""
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime


def measure(command: str, folder: Path, cache: Path, package: Path) -> Times:
    """Run a command once; return wall and processor time."""
    environment = os.environ | {
        "NUMBA_CACHE_DIR": str(cache),
        "PYTHONPATH": str(package),
    }
    processor = processor_time()
    begin = time.perf_counter()
    subprocess.run(
        [sys.executable, *command.split()],
        cwd=folder,
        env=environment,
        capture_output=True,
        check=True,
    )
    wall = time.perf_counter() - begin
    return wall, processor_time() - processor


def in_turn(cache: Path, package: Path) -> list[Times]:
    """Run all commands one after the other, in a new folder; return their times."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        shutil.copytree(CONFIGS, folder / "configs")
        (folder / "stone.yaml").write_text(STONE)
        (folder / "first.py").write_text(PYTHON)
        return [measure(each, folder, cache, package) for each in COMMANDS.values()]


def medians(times: list[Times]) -> str:
    """Return the medians of wall and processor times as text."""
    wall, processor = (statistics.median(values) for values in zip(*times, strict=True))
    return f"{wall:9.2f} ({processor:6.2f})"


def with_sum(times: list[Times]) -> list[Times]:
    """Return times with their sum behind them."""
    wall, processor = (sum(values) for values in zip(*times, strict=True))
    return [*times, (wall, processor)]


@click.command()
@click.option("--repeats", default=3, show_default=True)
@click.option(
    "--package",
    default=ROOT,
    type=click.Path(exists=True, file_okay=False, path_type=Path),
    help="Checkout whose package is measured.",
)
def main(repeats: int, package: Path) -> None:
    """Measure the commands in seconds, cold and warm; in brackets processor times."""
    click.echo(f"{heading()}\n{'':12}{'cold':>18}{'warm':>21}")
    cold = []
    warm = []
    with tempfile.TemporaryDirectory() as home:
        for number in range(repeats):
            cache = Path(home) / str(number)
            cache.mkdir(mode=0o700)
            cold.append(with_sum(in_turn(cache, package.resolve())))
            warm.append(with_sum(in_turn(cache, package.resolve())))
    for row, name in enumerate([*COMMANDS, "all"]):
        times = medians([times[row] for times in cold])
        again = medians([times[row] for times in warm])
        click.echo(f"{name:12}{times}   {again}")


if __name__ == "__main__":
    main()
