"""Draw the small pictures of the gallery on the first page of the documentation.

    python docs/figures/gallery.py [docs/gallery]

It runs configs/quickstart.yaml twice, at two tolerances, in a temporary folder: about a
minute.  The other pictures of the gallery have scripts and commands of their own.
"""

from __future__ import annotations

import shlex
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
SIZE = "--size 4.4,3 --dpi 110 --no-caption"
PICTURES = {
    "times": f"plot out/quickstart --kind times {SIZE}",
    "ratio": f"plot out/quickstart --kind ratio {SIZE}",
    "scatter": f"plot out/quickstart --kind scatter --colour theta {SIZE}",
    "distribution": f"plot out/quickstart --kind distribution {SIZE}",
    "bins": f"plot out/quickstart --kind fractions --x xi {SIZE} "
    "--select K_r=0.01 --select n_i=-0.3",
}
FIGURES = {
    "trajectory": "trajectory --preset GH --n-i 0.1 --omega-xy0 0.01 --t-end 250",
    "section": (
        "trajectory --preset GH --n-i -0.3 --omega-xy0 0.1 --t-end 4e4 "
        "--section omega_y=0+"
    ),
    "compare": "compare out/quickstart out/tol-1e-7",
}
RUNS = (
    "run configs/quickstart.yaml -q --output out/quickstart",
    "run configs/quickstart.yaml -q --set integrator.tol=1e-7 --output out/tol-1e-7",
)


def main() -> None:
    """Write all pictures."""
    target = Path(sys.argv[1] if len(sys.argv) > 1 else ROOT / "docs/gallery").resolve()
    target.mkdir(exist_ok=True)
    commands = list(RUNS)
    commands += [
        f"{line} --output {target}/{name}.png" for name, line in PICTURES.items()
    ]
    commands += [
        f"{line} --figure {target}/{name}.png" for name, line in FIGURES.items()
    ]
    with tempfile.TemporaryDirectory() as folder:
        Path(folder, "configs").symlink_to(ROOT / "configs")
        for command in commands:
            program = [sys.executable, "-m", "rattlesweep", *shlex.split(command)]
            subprocess.run(program, cwd=folder, check=True)


if __name__ == "__main__":
    main()
