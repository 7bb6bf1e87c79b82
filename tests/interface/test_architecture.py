"""The plan of the house holds: who imports whom, and nobody imports what is private."""

import ast
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]


def test_the_contracts_of_imports_hold():
    program = Path(sys.executable).with_name("lint-imports")
    done = subprocess.run(
        [program, "--no-cache"], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert " 0 broken" in done.stdout


def test_no_private_imports_from_others():
    def private(module: str) -> bool:
        return any(part.startswith("_") and part != "__future__" for part in module.split("."))

    bad = []
    for path in sorted((ROOT / "rattlesweep").rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Import):
                bad += [(path.name, a.name) for a in node.names if private(a.name)]
            elif isinstance(node, ast.ImportFrom) and node.module:
                own = node.module.split(".")[0] == "rattlesweep"
                names = [node.module, *([] if own else [a.name for a in node.names])]
                bad += [(path.name, name) for name in names if private(name)]
    assert bad == []
