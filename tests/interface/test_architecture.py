"""The plan of the house holds: who imports whom, how long files are, what says what it does."""

import ast
import subprocess
import sys
from collections import Counter
from pathlib import Path

ROOT = Path(__file__).parents[2]
MODULES = sorted((ROOT / "rattlesweep").rglob("*.py"))
NAMES = [str(path.relative_to(ROOT)) for path in MODULES]


def test_the_contracts_of_imports_hold():
    program = Path(sys.executable).with_name("lint-imports")
    done = subprocess.run(
        [program, "--no-cache"], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert "7 kept, 0 broken" in done.stdout


def test_modules_are_short():
    long = {
        name: count
        for name, path in zip(NAMES, MODULES, strict=True)
        if (count := len(path.read_text().splitlines())) > 400
    }
    assert long == {}


def test_folders_are_small():
    # Of commands there is one a file.
    folders = Counter(path.parent for path in MODULES if path.name != "__init__.py")
    del folders[ROOT / "rattlesweep" / "cli"]
    assert {str(f): count for f, count in folders.items() if count > 14} == {}


def test_no_private_imports_from_others():
    def private(module: str) -> bool:
        return any(part.startswith("_") and part != "__future__" for part in module.split("."))

    bad = []
    for name, path in zip(NAMES, MODULES, strict=True):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Import):
                bad += [(name, a.name) for a in node.names if private(a.name)]
            elif isinstance(node, ast.ImportFrom) and node.module:
                own = node.module.split(".")[0] == "rattlesweep"
                names = [node.module, *([] if own else [a.name for a in node.names])]
                bad += [(name, n) for n in names if private(n)]
    assert bad == []
