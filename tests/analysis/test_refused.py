"""What `plot`, `report`, `show` and `replay` refuse: in one sentence, and nothing is left."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import pytest
from editing import edited
from refusal import assert_refused
from sweeping import invoke, tree

import rattlesweep as rs

GH = {"source": "preset", "name": "GH"}
SD = {"source": "sd", "samples": 3, "target": {"K_r": [0.02, 0.1], "rel_tol": 0.1}}
MAP = {
    "source": "grid",
    "base": {"preset": "GH"},
    "axes": {"theta": {"linspace": [0.6, 0.98, 9]}},
}
SWEEPS: dict[str, dict[str, Any]] = {
    "steady": {"bodies": SD, "spin": {"n_i": [-0.5, -0.1], "omega_xy0": [0.01, 0.1]}},
    "map": {
        "bodies": MAP,
        "spin": {"n_i": {"linspace": [-0.6, 0.6, 10]}, "omega_xy0": 0.01},
    },
    "one": {"bodies": GH, "spin": {"n_i": 0.1, "omega_xy0": 0.01}},
    "full": {
        "bodies": GH,
        "spin": {"n_i": [0.1, 0.2], "omega_xy0": 0.01},
        "model": "full",
    },
}


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Sweeps of every shape, broken ones, and a style file that is none."""
    root = tmp_path_factory.mktemp("place")
    for name, config in SWEEPS.items():
        rs.sweep({"model": "gh", **config}, output=root / name, threads=1)
    for name in ("broken", "damaged"):
        shutil.copytree(root / "one", root / name)
    (root / "broken" / "manifest.json").write_text("{}")
    (block,) = (root / "damaged" / "runs").iterdir()
    block.write_bytes(block.read_bytes()[:-200])
    edited(root / "one", root / "empty", lambda rows: rows[:0])
    (root / "bad.mplstyle").write_text("font.size: [x\n")
    return root


FIRST = ("--case", 0, "--sample", 0)
REFUSED: dict[str, list[tuple[tuple[Any, ...], str]]] = {
    "plot": [
        (("steady", "--title", r"$\notacommand$"), "is no formula"),
        (("steady", "--title", "two\nlines"), "leave it out"),
        (("steady", "--kind", "times", "--ylim", "0,9"), "add --linear"),
        (("one", "--kind", "map"), "--kind map: does not fit this sweep"),
        (("map", "--kind", "reversals"), "does not fit"),
        (("map", "--quantity", "n_step"), '--quantity: "n_step" is not one of'),
        (("steady", "--x", "K_s"), '"K_s" is not one of K_r, n_i, omega_xy0'),
        (("steady", "--select", "n_i=-0.2"), "no value -0.2; there are -0.5, -0.1"),
        (("steady", "--select", "n_i=a"), "is not NAME=VALUES"),
        (("steady", "--where", "t_R < 3"), 'did you mean "t_r"?'),
        (("steady", "--where", "t_r < 0"), "1: holds no run of those selected"),
        (("steady", "--style", "none.mplstyle"), "No such file"),
        (("steady", "--style", "bad.mplstyle"), "font.size"),
        (("map", "--log"), "has values that are not positive"),
        (("one", "--output", "no/p.svg"), "1: cannot write no/p.svg: No such file"),
        (("broken",), "1: is damaged"),
        (("empty",), "1: holds no runs yet"),
    ],
    "report": [
        (("damaged",), "1: damaged/runs/"),
    ],
    "show": [
        (("--preset", "GH", "--output", "a.htm"), "the name must end in .html"),
        (("--preset", "GH", "--case", 1), "choose a run of a DIRECTORY"),
        (("full", *FIRST, "--theta", 0.7), "--theta: the sweep in full says what the run was"),
        (("one", *FIRST), "the model gh has no body that moves"),
    ],
    "replay": [
        (("full", "--case", 9, "--sample", 0), "has the cases 0 to 1"),
        (("full", "--case", 0), "which run?"),
        (("full", *FIRST, "--where", "K_r<1"), "keep one way"),
        (("full", "--where", "K_r<1", "--first", 2), "2 runs do not go into one table"),
        (("full", *FIRST, "--channels", "t,omga_x"), 'did you mean "omega_x"?'),
        (("full", *FIRST, "--output", "a.xlsx"), ".parquet or .csv"),
    ],
}


@pytest.mark.parametrize(
    ("command", "arguments", "words"),
    [(command, *case) for command, cases in REFUSED.items() for case in cases],
    ids=lambda value: value if isinstance(value, str) else " ".join(map(repr, value)),
)
def test_what_is_wrong_is_one_sentence(place, monkeypatch, command, arguments, words):
    """With exit code 2, or 1 where it is said."""
    monkeypatch.chdir(place)
    before = tree(place)
    code, words = (1, words[3:]) if words.startswith("1: ") else (2, words)
    where = ["--output", "a.html"] if command == "show" and "--output" not in arguments else []
    assert_refused(invoke(command, *where, *arguments), code, words)
    assert tree(place) == before
