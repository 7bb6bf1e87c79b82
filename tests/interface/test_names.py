"""A public name stands for one thing in the whole package, or for the same thing."""

import ast
from collections import Counter, defaultdict

from sweeping import CONFIGS

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


def _defined(node: ast.stmt) -> list[str]:
    if isinstance(node, ast.FunctionDef | ast.ClassDef):
        return [node.name]
    targets: list[ast.expr] = []
    if isinstance(node, ast.Assign):
        targets = node.targets
    elif isinstance(node, ast.AnnAssign):
        targets = [node.target]
    return [target.id for target in targets if isinstance(target, ast.Name)]
