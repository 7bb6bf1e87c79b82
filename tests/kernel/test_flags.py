"""Flags of compiled functions: none follows from what was compiled before.

A function takes flags that it does not name over from the caller that is compiled first
(Numba's issue 7168), and a power by a whole number those of the function that first has
one (``findings/numba_power_takes_other_flags.sh``).
"""

import ast

from sweeping import CONFIGS

from rattlesweep.compiling import intrinsics

PACKAGE = CONFIGS.parent / "rattlesweep"
NAMED = {"fastmath", "forceinline"}
COMPILERS = {"njit", "register_jitable"}


def sources():
    """Return the sources of the package, parsed, by path."""
    return {
        path.relative_to(PACKAGE).as_posix(): ast.parse(path.read_text("utf-8"))
        for path in PACKAGE.rglob("*.py")
    }


def called(node):
    """Return the name that a call or a decorator calls, or an empty one."""
    if isinstance(node, ast.Call):
        node = node.func
    return node.id if isinstance(node, ast.Name) else ""


def names_flags(call):
    """Return whether the options of a call of `njit` name the flags."""
    given = {keyword.arg for keyword in call.keywords}
    shared = [keyword.value for keyword in call.keywords if keyword.arg is None]
    names = [
        node.id
        for value in shared
        for node in ast.walk(value)
        if isinstance(node, ast.Name) and node.id.isupper()
    ]
    options = [getattr(intrinsics, name) for name in names]
    return given >= NAMED or (
        bool(options) and all(given | each.keys() >= NAMED for each in options)
    )


def test_compiled_functions_name_their_flags():
    seen = 0
    missing = []
    for path, tree in sources().items():
        for node in ast.walk(tree):
            if not isinstance(node, ast.Call) or called(node) not in COMPILERS:
                continue
            if path == "compiling/loading.py":
                # A kernel has no caller that is compiled.
                continue
            seen += 1
            if not names_flags(node):
                missing.append(f"{path}:{node.lineno}")
    assert seen > 150
    assert missing == []


def test_compiled_functions_have_no_powers():
    seen = 0
    powers = []
    for path, tree in sources().items():
        for node in ast.walk(tree):
            if not isinstance(node, ast.FunctionDef):
                continue
            decorators = set(map(called, node.decorator_list))
            if decorators.isdisjoint(COMPILERS | {"scalar"}):
                continue
            seen += 1
            powers += [
                f"{path}:{inner.lineno}"
                for inner in ast.walk(node)
                if isinstance(inner, ast.BinOp) and isinstance(inner.op, ast.Pow)
            ]
    assert seen > 250
    assert powers == []
