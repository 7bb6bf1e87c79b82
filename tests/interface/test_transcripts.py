"""Commands print what is kept in `tests/net/transcripts.txt`; executed, this file
writes it anew.

Seconds, sizes, dates, processes and paths are masked, and numbers rounded to five
digits.
"""

from __future__ import annotations

import os
import re
import shlex
import sys
import tempfile
from pathlib import Path

from click.testing import CliRunner

from rattlesweep.cli import main
from rattlesweep.system.console import COMPILING

FILE = Path(__file__).parents[1] / "net" / "transcripts.txt"
FILES = {
    "sd.yaml": "bodies:\n"
    "  {source: sd, samples: 4, target: {K_r: [0.02, 0.1], rel_tol: 1e-2}}\n"
    "spin: {n_i: [-0.3, 0.4], omega_xy0: 0.1}\nhorizon: {t_rgh: 5, t: 2000}\n",
    "gh.yaml": "bodies: {source: preset, name: GH}\n"
    "spin: {n_i: [0.1, -0.1], omega_xy0: 0.01}\nrecord: [error]\n",
    "failing.yaml": "bodies: {source: sd, samples: 4}\n"
    "spin: {n_i: -0.3, omega_xy0: 0.1}\nintegrator: {max_steps: 400}\n",
    "bad.yaml": "nmae: x\nbodies: {source: sd, samples: -1}\n"
    "spin: {n_i: [0.1, oops]}\n",
}
COMMANDS = r"""
--help
init mine.yaml
plan sd.yaml --check
plan bad.yaml
body --preset GH --n-i -0.1
run sd.yaml
run sd.yaml
run sd.yaml --set bodies.samples=6
run sd.yaml --set seed=7
run sd.yaml --output half --shard 0/2 -q
merge half --output part
run failing.yaml
run failing.yaml --retry-failed --set integrator.max_steps=100000 -q
run gh.yaml -q
status out/sd
verify out/gh --recompute 2
classify out/sd --set classify.sw_departure=0.2
compare out/gh out/gh
plot out/sd
trajectory --preset GH --t-end 150 --points 4 --channels t,n,E_p
replay out/gh --case 1 --sample 0 --points 3 --t-end 900
"""


def masked(text: str) -> str:
    """Replace what differs from machine to machine and from run to run."""
    text = re.sub(r"\d{4}-\d\d-\d\d[T ]\d\d:\d\d(:\d\d)?(\.\d+)?", "DATE", text)
    # Versions of click differ in it.
    text = text.replace(" COMMAND [ARGS]", " [COMMAND] [ARGS]")
    text = re.sub(r"process \d+ on \S+,", "process N on HOST,", text)
    text = re.sub(r"\b[\d.]+ (s|ms|kB|MB|GB)\b", r"N \1", text)
    text = re.sub(
        r"-?\d+\.\d{5,}(e[+-]\d+)?", lambda number: f"{float(number[0]):.5g}", text
    )
    return re.sub(r"(?<!\+)\b\d+ steps", "N steps", text)


def make() -> str:
    """Run the commands in the working directory and return their transcript."""
    for name, text in FILES.items():
        Path(name).write_text(
            f"name: {Path(name).stem}\n" * (name != "bad.yaml") + text
        )
    transcripts = []
    for line in COMMANDS.strip().splitlines():
        args = shlex.split(line)
        sys.argv = ["rattlesweep", *args]
        result = CliRunner().invoke(main, args, prog_name="rattlesweep")
        if not isinstance(result.exception, SystemExit | None):
            raise result.exception
        # What only a slow machine says is left out.
        messages = [
            f"! {message}\n"
            for message in result.stderr.splitlines()
            if message != COMPILING and not re.match(r"\d+\.\d %, ", message)
        ]
        shown = "".join([f"$ rattlesweep {line}\n", result.stdout, *messages])
        transcripts.append(f"{masked(shown)}[{result.exit_code}]\n")
    return "\n".join(transcripts)


def test_commands_print_what_is_kept(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sys.argv", [])
    monkeypatch.setenv("COLUMNS", "80")
    for one, other in zip(
        make().split("\n$ "), FILE.read_text().split("\n$ "), strict=True
    ):
        assert one == other


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        FILE.write_text(make())
