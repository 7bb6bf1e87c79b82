"""The plan of the house holds: who imports whom, how long files are, what says what it does."""

from __future__ import annotations

import ast
import subprocess
import sys
from collections import Counter
from functools import cache
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


@cache
def trees() -> list[tuple[str, ast.Module]]:
    return [(n, ast.parse(p.read_text())) for n, p in zip(NAMES, MODULES, strict=True)]


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


def is_overload(node: ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef) -> bool:
    """Whether it is a signature for type checkers; what it does is said once, below."""
    return any(isinstance(d, ast.Name) and d.id == "overload" for d in node.decorator_list)


def public(node: ast.AST, inside: str = "") -> list[tuple[str, ast.AST]]:
    found: list[tuple[str, ast.AST]] = []
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            if child.name.startswith("_") or is_overload(child):
                continue
            name = f"{inside}{child.name}"
            found.append((name, child))
            if isinstance(child, ast.ClassDef):
                found += public(child, f"{name}.")
    return found


def test_everything_public_says_what_it_is():
    silent = [
        f"{path}: {name}"
        for path, tree in trees()
        for name, node in public(tree)
        if not ast.get_docstring(node)
    ]
    assert silent == []
    assert [path for path, tree in trees() if tree.body and not ast.get_docstring(tree)] == []


def test_no_private_imports_from_others():
    def private(module: str) -> bool:
        return any(part.startswith("_") and part != "__future__" for part in module.split("."))

    bad = []
    for path, tree in trees():
        for node in ast.walk(tree):
            if isinstance(node, ast.Import):
                bad += [(path, a.name) for a in node.names if private(a.name)]
            elif isinstance(node, ast.ImportFrom) and node.module:
                own = node.module.split(".")[0] == "rattlesweep"
                names = [node.module, *([] if own else [a.name for a in node.names])]
                bad += [(path, n) for n in names if private(n)]
    assert bad == []
