"""Of which code a result is: the modules that its module reaches, without their sentences.

Comments, docstrings and the messages of errors do not count, and neither does what draws: an
edited sentence keeps the data, an edited formula anywhere below does not.
"""

from __future__ import annotations

import ast
import hashlib
from functools import cache
from pathlib import Path

PACKAGE = Path(__file__).resolve().parents[1]
ROOM = "rattlesweep.paper"
# What only pictures depend on.
PICTURES = f"{ROOM}.style"


@cache
def code_key(name: str, *, pictures: bool = False) -> str:
    """Hash of the code that the data of a figure depend on, or its picture.

    Parameters
    ----------
    name : str
        Module of the room of the paper, such as ``fig2``.
    pictures : bool
        Whether functions called ``draw`` and the style of the figures count.
    """
    digest = hashlib.sha256()
    left, seen = [f"{ROOM}.{name}" if name == "sweeps" else f"{ROOM}.figures.{name}"], set()
    while left:
        module = left.pop()
        if module in seen or (module == PICTURES and not pictures):
            continue
        seen.add(module)
        own, reached = _bare(module, pictures and module.startswith(ROOM))
        digest.update(own)
        left += sorted(reached - seen, reverse=True)
    return digest.hexdigest()


@cache
def _bare(module: str, pictures: bool) -> tuple[bytes, set[str]]:
    """Hash of a module, and the modules that it imports."""
    tree = _Bare(pictures).visit(ast.parse(_file(module).read_bytes()))
    text = f"{module} {ast.dump(tree, annotate_fields=False)}"
    return hashlib.sha256(text.encode()).digest(), _imports(tree)


def _file(module: str) -> Path:
    return PACKAGE.joinpath(*module.split(".")[1:]).with_suffix(".py")


def _imports(tree: ast.AST) -> set[str]:
    found = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.module and node.level == 0:
            found |= {node.module, *(f"{node.module}.{each.name}" for each in node.names)}
    # Names that are no modules have no file; a package's own file only gathers names.
    return {name for name in found if name.startswith("rattlesweep.") and _file(name).is_file()}


class _Bare(ast.NodeTransformer):
    """Leave out sentences, what only type checkers read, and pictures unless they are wanted."""

    def __init__(self, pictures: bool) -> None:
        self.pictures = pictures

    def visit_Expr(self, node: ast.Expr) -> ast.Expr | None:
        return None if isinstance(node.value, ast.Constant) else node

    def visit_Raise(self, _: ast.Raise) -> None:
        return None

    def visit_If(self, node: ast.If) -> ast.AST | None:
        if isinstance(node.test, ast.Name) and node.test.id == "TYPE_CHECKING":
            return None
        return self.generic_visit(node)

    def visit_FunctionDef(self, node: ast.FunctionDef) -> ast.AST | None:
        return None if node.name == "draw" and not self.pictures else self.generic_visit(node)
