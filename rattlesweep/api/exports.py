"""Runs as files that physics engines and other programs can repeat."""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rattlesweep.api.single import INTEGRATOR, NumberOrText, prepare_launch
from rattlesweep.physics import si
from rattlesweep.physics.body import Rattleback
from rattlesweep.words.defaults import CASE_NAME, EXPORT_FORMAT
from rattlesweep.words.engines import ENGINES
from rattlesweep.words.errors import ConfigError
from rattlesweep.words.names import EXPORT_FORMATS

if TYPE_CHECKING:
    from rattlesweep.analysis.engines.case import EngineCase
    from rattlesweep.analysis.onerun.course import PreparedRun


def export(
    body: Rattleback | str,
    *,
    format: str = EXPORT_FORMAT,
    engine: str | None = None,
    portable: bool = False,
    length: NumberOrText | None = None,
    name: str = CASE_NAME,
    path: str | Path | None = None,
    **launch: Any,
) -> str:
    """Return a run as a file for a physics engine, with what the engine should find.

    Two methods integrate the run at their tightest tolerance.  The file has the body,
    the launch and the first reversal in SI units, with z up.

    Stability: may change.

    Parameters
    ----------
    body, **launch
        As for ``trajectory``, but without a method.
    format : str
        ``mjcf``, a model of MuJoCo, of an ellipsoid; or ``json``, a document whose
        schema ``rattlesweep schema --case`` prints.
    engine : str, optional
        Instead of a format, the engine of a Python file that repeats the run there and
        prints its first reversal: one of ``mujoco``, ``mjx``, ``newton``, ``drake``,
        ``dart``, ``genesis``, ``motrix``, ``bullet``, ``rapier`` and ``exudyn``.
    portable : bool
        Keep a model to what most readers of MJCF know.
    length : float or str, optional
        Height of the centre of mass, in m, which a body without a size needs.  Such a
        body has a mass of 1 kg.
    name : str
        Name of the case.
    path : str or Path, optional
        An .xml, .json or .py file to write the text to.

    Raises
    ------
    ConfigError
        If an argument is wrong, the format cannot have the body or its friction, the
        run fails, or the methods disagree on its first reversal.
    """
    for setting in INTEGRATOR:
        if launch.get(setting) is not None:
            raise ConfigError(
                f"{setting}: two methods integrate an export at their tightest "
                f"tolerance; leave {setting} out"
            )
    run = prepare_launch(body, **launch)
    return export_run(run, format, length, name, path, engine, portable)[0]


def ending_of(format: str, engine: str | None) -> str:
    """Return the ending of the files of a format, or of an engine."""
    from rattlesweep.analysis.engines.formats import EXPORTED

    if engine is not None:
        return ".py"
    return EXPORTED[format].ending


def export_run(
    run: PreparedRun,
    format: str,
    length: NumberOrText | None,
    name: str,
    path: str | Path | None,
    engine: str | None,
    portable: bool,
) -> tuple[str, EngineCase]:
    """Return the text of an export and its case; write the text if there is a path."""
    from rattlesweep.analysis.engines.case import make_case
    from rattlesweep.analysis.engines.formats import EXPORTED
    from rattlesweep.analysis.engines.script import check_name, check_run, to_script
    from rattlesweep.system.files import as_path, replace_file
    from rattlesweep.words.errors import not_one_of

    if format not in EXPORT_FORMATS:
        raise ConfigError(f"format: {not_one_of(format, EXPORT_FORMATS)}")
    if engine is not None and engine not in ENGINES:
        raise ConfigError(f"engine: {not_one_of(engine, ENGINES)}")
    if portable and (engine is not None or format != "mjcf"):
        raise ConfigError("portable: only a model (mjcf) can be; leave portable out")
    if path is not None:
        path = as_path(path, "path")
        ending = ending_of(format, engine)
        if path.suffix.lower() != ending:
            raise ConfigError(
                f"path {path}: a file of {engine or f'the format {format}'} ends in "
                f"{ending}"
            )
        if engine is not None:
            check_name(path, engine)
    if run.config.acting.is_shaken:
        raise ConfigError(
            "base: no format has a plane that shakes; leave it out to export the body"
        )
    if engine is not None:
        check_run(run, engine)
    else:
        EXPORTED[format].check(run)
    case = make_case(run, str(name), height=_height(length))
    if engine is not None:
        text = to_script(case, engine)
    else:
        text = EXPORTED[format].write(case, portable)
    if path is not None:
        replace_file(path, text.encode())
    return text, case


def _height(length: NumberOrText | None) -> float | None:
    """Return a length in m."""
    if length is None:
        return None
    try:
        return si.size(length, "length", "length")
    except ValueError as error:
        raise ConfigError(str(error)) from None


def write_cases(directory: Path) -> list[Path]:
    """Write the reference cases and their schema to a directory; return the files."""
    import json

    from ruamel.yaml import YAML

    from rattlesweep.analysis.engines.case import case_schema, make_case
    from rattlesweep.analysis.engines.mjcf import to_mjcf
    from rattlesweep.design.bodies.making import body_from
    from rattlesweep.system.files import probe_directory, replace_file

    source = files("rattlesweep.analysis.engines") / "cases.yaml"
    texts = {"schema.json": json.dumps(case_schema(), indent=1) + "\n"}
    for name, keys in YAML(typ="safe").load(source.read_text("utf-8")).items():
        run = prepare_launch(body_from(keys["body"]), **keys["launch"])
        case = make_case(run, name, keys["about"], _height(keys.get("length")))
        texts[f"{name}.json"] = case.to_json()
        texts[f"{name}.xml"] = to_mjcf(case, keys.get("one_percent"))
    probe_directory(directory)
    for file, text in texts.items():
        replace_file(directory / file, text.encode())
    return [directory / file for file in texts]
