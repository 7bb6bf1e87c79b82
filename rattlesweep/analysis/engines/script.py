"""A case as a Python file that runs in a physics engine and judges what it finds.

The file has the numbers of the case, the adapter of the engine and a frame.  An adapter
is a module of `adapters` with `build`, `advance` and `look`; it knows nothing of
reversals.
"""

from __future__ import annotations

import ast
import math
from importlib.resources import files
from pathlib import Path
from pprint import pformat
from textwrap import fill
from typing import Any

from rattlesweep.analysis.engines.case import EngineCase
from rattlesweep.analysis.engines.mjcf import check_model, friction_and_lever
from rattlesweep.analysis.onerun.course import PreparedRun
from rattlesweep.words.engines import ENGINES
from rattlesweep.words.errors import ConfigError, printable

HERE = "rattlesweep.analysis.engines.adapters"


def check_name(path: Path, engine: str) -> None:
    """Raise a ConfigError if a file would hide a package that it imports."""
    if path.stem in {engine, ENGINES[engine].installs}:
        raise ConfigError(
            f"path {path}: a file of this name hides the package that it imports; "
            f"call it {path.stem}_run.py"
        )


def check_run(run: PreparedRun, engine: str) -> None:
    """Raise a ConfigError if an engine has no such body or no such friction."""
    check_model(run, ENGINES[engine].title, ENGINES[engine].pivots)


def numbers_of(case: EngineCase) -> dict[str, Any]:
    """Return the numbers of a case in SI units, for files in Python.

    Raises
    ------
    ConfigError
        If the spin does not reverse.
    """
    if case.expected.first_reversal is None:
        raise ConfigError(
            f"t_end: the spin does not reverse by {case.expected.until:g} s; take a "
            "later one, as the file measures the first reversal"
        )
    body = case.body
    surface = body.surface
    friction, lever = friction_and_lever(case)
    assert surface.semi_axes is not None
    assert surface.centre is not None
    w, x, y, z = case.launch.quaternion
    vertical = 2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)
    return {
        "name": case.name,
        "mass": body.mass,
        "height": body.height,
        "inertia": list(body.inertia),
        "semi_axes": list(surface.semi_axes),
        "angle": surface.angle,
        "centre": list(surface.centre),
        "gravity": case.plane.gravity,
        "friction": friction,
        "lever": lever,
        "position": list(case.launch.position),
        "quaternion": [number + 0.0 for number in case.launch.quaternion],
        "velocity": list(case.launch.velocity),
        "omega": list(case.launch.omega),
        "spin": sum(a * b for a, b in zip(vertical, case.launch.omega, strict=True)),
        "counts_above": case.expected.counts_above,
        "energy": case.expected.energy,
        "first_reversal": case.expected.first_reversal.time,
    }


def to_script(case: EngineCase, name: str) -> str:
    """Return the Python file of the case of a run that passed :func:`check_run`.

    Raises
    ------
    ConfigError
        If the spin does not reverse.
    """
    engine = ENGINES[name]
    step = engine.step * math.sqrt(case.body.height / case.plane.gravity)
    about = (
        f"{printable(case.name)}: a rattleback in {engine.title}, written by "
        f"{case.made_by}. Numbers are in SI units, z is up, the quaternion has its "
        "scalar first, `velocity` is that of the centre of mass along the world's axes "
        "and `omega` along the body's. The file prints the first reversal, and how "
        f"far the lowest point slips and sinks. {engine.remark}"
    )
    parts = ["frame", name]
    if engine.reads_mjcf:
        parts.insert(0, "mjcf")
    imports: dict[str, None] = {}
    texts = []
    for part in parts:
        source = (files(HERE) / f"{part}.py").read_text("utf-8")
        found, text = _taken_apart(source)
        imports.update(dict.fromkeys(found))
        texts.append(text)
    quoted = fill(about.strip(), 84).replace("\\", "\\\\").replace('"""', "'''")
    return "\n".join(
        [
            f'"""{quoted}\n\n    pip install {engine.installs} numpy\n"""\n',
            *sorted(imports, key=lambda line: (line.startswith("from"), line)),
            "import sys\n",
            f"CASE = {pformat(numbers_of(case), sort_dicts=False)}\n\n",
            "\n\n\n".join(texts),
            '\n\nif __name__ == "__main__":',
            f"    main(sys.modules[__name__], CASE, {float(f'{step:.4g}')!r})\n",
        ]
    )


def _taken_apart(source: str) -> tuple[list[str], str]:
    """Return the imports of a module, without those from here, and what follows."""
    lines = source.splitlines()
    imports = []
    end = 0
    for node in ast.parse(source).body:
        is_docstring = isinstance(node, ast.Expr)
        if not is_docstring and not isinstance(node, ast.Import | ast.ImportFrom):
            break
        assert node.end_lineno is not None
        if isinstance(node, ast.Import | ast.ImportFrom):
            text = "\n".join(lines[node.lineno - 1 : node.end_lineno])
            if HERE not in text:
                imports.append(text)
        end = node.end_lineno
    return imports, "\n".join(lines[end:]).strip()
