"""The pages of docs/ say what is: their commands are executed, in order, as a reader
would.
"""

import json
import re
import shlex
import shutil
from pathlib import Path

import matplotlib.pyplot as plt
import pytest
from sweeping import ROOT, invoke


@pytest.fixture
def here(tmp_path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A working directory with the shipped configs."""
    shutil.copytree(ROOT / "configs", tmp_path / "configs")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def blocks(page: str, language: str) -> list[str]:
    """Code blocks of a page that are to be executed: those whose fence says just the
    language.
    """
    text = (ROOT / "docs" / page).read_text()
    return re.findall(rf"^```{language}\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)


def execute(page: str, about: str = "") -> int:
    """Do what the shell blocks of a page say that hold some words; how many commands
    that are.
    """
    commands = 0
    for block in (block for block in blocks(page, "sh") if about in block):
        heredoc = re.compile(
            r"^python - <<'PYTHON'\n(.*?)^PYTHON\n", re.MULTILINE | re.DOTALL
        )
        for place, part in enumerate(heredoc.split(block)):
            if place % 2:
                exec(part, {})
                continue
            for line in filter(None, part.replace("\\\n", "").splitlines()):
                program, *args = shlex.split(line, comments=True)
                assert program == "rattlesweep"
                result = invoke(*args)
                assert result.exit_code == 0, line + result.stderr
                print(result.stdout + result.stderr)
                commands += 1
    return commands


@pytest.mark.slow
def test_the_tutorial_from_install_to_a_map(here: Path):
    assert execute("tutorial.md") >= 12
    wanted = {
        "unsteady.parquet",
        "unsteady.svg",
        "steady.csv",
        "steady.svg",
        "rattleback.html",
        "fractions.png",
        "wobble.parquet",
        "wobble.svg",
        "first.html",
        "map.png",
    }
    assert all((here / name).stat().st_size > 500 for name in wanted)


def test_from_a_ruler_and_a_scale_to_seconds(
    here: Path, capsys: pytest.CaptureFixture[str]
):
    """What the page shows is what its commands print, but for last digits and numbers
    of steps.
    """

    def plain(text: str) -> str:
        text = re.sub(r"\d+ steps", "N steps", text)
        text = re.sub(r"\b\de-\d\d\b", "1e-09", text)  # of an error, not even one digit
        return re.sub(r"-?\d+\.\d{6,}", lambda number: f"{float(number[0]):.6g}", text)

    assert execute("own_stone.md") == 2
    assert execute("friction.md", "rattlesweep contact") == 2
    shown = plain(capsys.readouterr().out)
    for block in (*blocks("own_stone.md", "text"), *blocks("friction.md", "text")):
        for line in plain(block).splitlines():
            assert line == "..." or line in shown, line


def test_the_examples_of_the_readme(here: Path):
    chosen = ("--set", "bodies.samples=5", "-q")
    assert invoke("run", "configs/quickstart.yaml", *chosen).exit_code == 0
    assert execute("../README.md", "rattlesweep body") >= 4
    (code,) = blocks("../README.md", "python")
    exec(code, {})


def test_the_python_page(here: Path):
    found = blocks("python.md", "python")
    assert len(found) >= 6
    exec("\n".join(found), {"__name__": "__main__"})


def test_the_notebook_runs_and_finds_what_it_shows():
    notebook = json.loads((ROOT / "docs" / "notebook.ipynb").read_text("utf-8"))
    cells = [cell for cell in notebook["cells"] if "outputs" in cell]
    names: dict[str, object] = {}
    for cell in cells:
        exec("".join(cell["source"]), names)
    shown = [out["data"]["text/plain"] for cell in cells for out in cell["outputs"]]
    text = "".join(map("".join, shown))
    assert all(f"{value:.6f}" in text for value in names["runs"]["t_r_s"])
    assert names["sweep"].summary["runs"].sum() == 600
    plt.close("all")
