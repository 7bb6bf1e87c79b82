"""The notebook of the documentation runs from top to bottom."""

import json
from pathlib import Path

import matplotlib.pyplot as plt

NOTEBOOK = Path(__file__).parents[2] / "docs" / "notebook.ipynb"


def test_the_notebook_runs_and_finds_what_it_shows():
    cells = [cell for cell in json.loads(NOTEBOOK.read_text("utf-8"))["cells"] if "outputs" in cell]
    names: dict[str, object] = {}
    for cell in cells:
        exec("".join(cell["source"]), names)
    shown = "".join(
        "".join(output["data"]["text/plain"]) for cell in cells for output in cell["outputs"]
    )
    for value in names["runs"]["t_r_s"]:
        assert f"{value:.6f}" in shown
    assert names["sweep"].summary["runs"].sum() == 600
    plt.close("all")
