"""A public name stands for one thing in the whole package, or for the same thing."""

import ast
import re
from collections import Counter, defaultdict

from sweeping import CONFIGS

import rattlesweep as rs

PACKAGE = CONFIGS.parent / "rattlesweep"
# Names that stand in two modules or more, and why each is one thing.
SAME = {
    "a command and its call in Python": """
        branch classify compare export fit merge orbit replay sensitivity show status
        trajectory verdict verify
    """,
    "a formula for numbers and for bodies": "bondi_threshold growth_rates modes",
    "the same quantity in other variables": """
        CONSTANTS N_EXTRA N_STATE contact_force energy rhs rolling_rhs spin spin_rate
        track
    """,
    "a tangent, and each tangent of a frame": "rate seed transverse",
    "what a mode does there": "advance hold_back observe settle store work",
}
# Modules with one name: why, and which.
SAME_MODULES = {
    "a subject in Python, in commands, and what it computes": """
        contact exports fits orbits style sweeps verdict
    """,
    "a mode and its equations": "slides",
}


def test_a_public_name_means_one_thing():
    modules = defaultdict(set)
    # The adapters of engines have equal names, and their files run by themselves.
    own = [path for path in PACKAGE.rglob("*.py") if path.parent.name != "adapters"]
    for path in own:
        for node in ast.parse(path.read_text("utf-8")).body:
            for name in _defined(node):
                if not name.startswith("_"):
                    modules[name].add(path.relative_to(PACKAGE).as_posix())
    doubled = {name: sorted(where) for name, where in modules.items() if len(where) > 1}
    known = {name for names in SAME.values() for name in names.split()}
    assert {name: doubled[name] for name in doubled.keys() - known} == {}


def test_a_module_has_a_name_of_its_own():
    own = [path for path in PACKAGE.rglob("*.py") if path.parent.name != "adapters"]
    counts = Counter(path.stem for path in own if path.stem != "__init__")
    doubled = {name for name, count in counts.items() if count > 1}
    assert doubled == {
        name for names in SAME_MODULES.values() for name in names.split()
    }


# Words before a dot that name no module where they stand: keys of configs, fields of a
# lane, files of a sweep.
NO_MODULES = {"bodies", "lane", "manifest", "summary", "tradeoff"}
REFERENCE = re.compile(r"`([a-z_]+(?:\.[A-Za-z_0-9]+)+)`")


def test_what_docstrings_and_comments_refer_to_is_there():
    names = {}
    for path in PACKAGE.rglob("*.py"):
        place = path.relative_to(PACKAGE.parent).with_suffix("").parts
        if place[-1] == "__init__":
            place = place[:-1]
        names[place] = _names_in(path.read_text("utf-8"))
    missing = []
    seen = 0
    for path in PACKAGE.rglob("*.py"):
        for reference in REFERENCE.findall(path.read_text("utf-8")):
            words = tuple(reference.split("."))
            # The module with the longest path that the reference begins with.
            for count in range(len(words), 0, -1):
                own = [place for place in names if place[-count:] == words[:count]]
                if own:
                    break
            if not own or words[0] in NO_MODULES or hasattr(rs, words[-1]):
                continue
            seen += 1
            rest = {*words[count:]}
            if not any(rest <= names[place] for place in own):
                missing.append(f"{path.relative_to(PACKAGE)}: {reference}")
    assert missing == []
    assert seen > 100


# Without a dot, a reference is to the module itself.
OWN = re.compile(r":(?:func|data|class|meth|attr):`([A-Za-z_0-9]+)`")


def test_references_without_a_module_are_to_their_own():
    missing = []
    seen = 0
    for path in PACKAGE.rglob("*.py"):
        source = path.read_text("utf-8")
        names = _names_in(source)
        for reference in OWN.findall(source):
            seen += 1
            if reference not in names:
                missing.append(f"{path.relative_to(PACKAGE)}: {reference}")
    assert missing == []
    assert seen > 100


def _names_in(source: str) -> set[str]:
    """Return all that a module defines, imports, or sets as an attribute."""
    names = set()
    for node in ast.walk(ast.parse(source)):
        match node:
            case ast.FunctionDef(name=name) | ast.ClassDef(name=name):
                names.add(name)
            case ast.Name(id=name) | ast.Attribute(attr=name) | ast.arg(arg=name):
                names.add(name)
            case ast.alias(name=name, asname=other):
                names.add((other or name).split(".")[-1])
    return names


def _defined(node: ast.stmt) -> list[str]:
    if isinstance(node, ast.FunctionDef | ast.ClassDef):
        return [node.name]
    targets: list[ast.expr] = []
    if isinstance(node, ast.Assign):
        targets = node.targets
    elif isinstance(node, ast.AnnAssign):
        targets = [node.target]
    return [target.id for target in targets if isinstance(target, ast.Name)]
