"""The command that writes a run for a physics engine."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click
from click import option

from rattlesweep.cli import options
from rattlesweep.cli.given import prepared_run
from rattlesweep.cli.options import command, probe_files, refuse, say, tell
from rattlesweep.words.defaults import CASE_NAME, EXPORT_FORMAT
from rattlesweep.words.errors import ConfigError


@command(
    "One run",
    "rattlesweep export --mass 0.5kg --height 3cm --inertia '15.3,4.5,18 kg cm^2' "
    "--radii '12,48 cm' --axes-angle 20deg --c 3cm --n-i '-5 rad/s' "
    "--omega-xy0 '2 rad/s' --psi 110 --t-end 3s --output demo.xml",
    "rattlesweep export --preset GH --length 1cm --format json --output gh.json",
    "rattlesweep export --half-ellipsoid 12cm,3cm,12mm --mass 60g --skew 8deg "
    "--n-i 60rpm --omega-xy0 6rpm --t-end 5s --engine drake --output half_drake.py",
    "rattlesweep export --cases engines",
)
@options.body_options
@options.launch_options
@option(
    "--length",
    type=options.HEIGHT,
    help="Height of the centre of mass, for a body without a size.",
)
@option(
    "--format",
    type=options.FORMAT_CHOICE,
    default=None,
    help="A model of MuJoCo, or a document with poses and a schema.  "
    f"[default: that of the file, or {EXPORT_FORMAT}]",
)
@option(
    "--engine",
    type=options.ENGINE_CHOICE,
    help="Instead of a format: a Python file that repeats the run in this engine and "
    "prints its first reversal.",
)
@option(
    "--portable",
    is_flag=True,
    help="Keep a model to what most readers of MJCF know: a free joint with a name, "
    "Euler's integrator, a plane that ends, a friction of 2 at most.",
)
@option("--name", metavar="TEXT", help=f"Name of the case.  [default: {CASE_NAME}]")
@options.file(
    "--output",
    ".xml",
    ".json",
    ".py",
    help="An .xml file of a model, a .json file or a .py file of an engine, instead of "
    "standard output.",
)
@option(
    "--cases",
    type=options.Kind("dir", Path),
    help="Instead of all these, write the reference cases to a directory.",
)
@options.quiet
def export(
    format: str | None,
    engine: str | None,
    portable: bool,
    name: str | None,
    length: float | None,
    output: Path | None,
    cases: Path | None,
    quiet: bool,
    **given: Any,
) -> None:
    """Write a run as a file that a physics engine can repeat.

    The file has the body, the launch and what to expect: the first reversal with its
    error, the direction and the friction that rolling needs. docs/engines.md says how
    well engines do.
    """
    from rattlesweep.api.exports import ending_of, export_run, write_cases

    if cases is not None:
        others = {
            **{"format": format, "engine": engine, "name": name},
            **{"length": length, "output": output, "portable": portable or None},
        }
        refuse(given | others, "the reference cases have their own; leave it out")
        tell(*write_cases(cases))
        return
    if format is not None and engine is not None:
        raise ConfigError("--engine: its file has its own form; leave --format out")
    probe_files(output)
    if format is None:
        format = EXPORT_FORMAT
        if output is not None and output.suffix.lower() == ending_of("json", None):
            format = "json"
    ending = ending_of(format, engine)
    if output is not None and output.suffix.lower() != ending:
        raise ConfigError(
            f"--output {output}: a file of {engine or f'the format {format}'} ends in "
            f"{ending}"
        )
    if name is None:
        name = given["preset"] or CASE_NAME
    text, case = export_run(
        prepared_run(given), format, length, name, output, engine, portable
    )
    if output is None:
        click.echo(text, nl=False)
    else:
        tell(output)
    if quiet:
        return
    reversal = case.expected.first_reversal
    if reversal is None:
        say(f"no reversal by {case.expected.until:g} s")
    else:
        say(f"first reversal at {reversal.time:.12g} s, +- {reversal.error:.1g} s")
    if "viscous" in case.plane.losses:
        return
    if case.plane.friction is None:
        needed = case.expected.contact.friction
        say(f"rolling needs a friction of {needed:.2g} up to then")
    elif case.expected.slides:
        say(f"slides up to then: {len(case.expected.slides)}")
