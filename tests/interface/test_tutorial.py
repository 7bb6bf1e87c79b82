"""The pages of docs/ say what is: their commands are executed, in order, as a reader would."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"


def blocks(page: str, language: str) -> list[str]:
    """Code blocks of a page that are to be executed: those whose fence says just the language."""
    text = (DOCS / page).read_text()
    return re.findall(rf"^```{language}\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)


def test_the_tutorial_from_install_to_a_map(tmp_path):
    shutil.copytree(ROOT / "configs", tmp_path / "configs")
    script = "set -eux\n" + "\n".join(blocks("tutorial.md", "sh"))
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    done = subprocess.run(
        ["bash", "-c", script],
        cwd=tmp_path,
        env={**os.environ, "PATH": path, "MPLBACKEND": "agg"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-3000:]
    assert done.stderr.count("+ rattlesweep") >= 12
    made = {p.name for p in tmp_path.iterdir()}
    wanted = {"unsteady.parquet", "unsteady.svg", "steady.csv", "steady.svg", "rattleback.html",
              "fractions.png", "wobble.parquet", "wobble.svg", "first.html", "map.png"}  # fmt: skip
    assert wanted <= made
    assert all((tmp_path / name).stat().st_size > 500 for name in wanted)


def test_the_python_page(tmp_path, monkeypatch):
    shutil.copytree(ROOT / "configs", tmp_path / "configs")
    monkeypatch.chdir(tmp_path)
    found = blocks("python.md", "python")
    assert len(found) >= 6
    # In a process of its own: it sets nothing here.
    code = "\n".join(found)
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", code], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
