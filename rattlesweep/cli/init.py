"""`rattlesweep init`: a config to begin with."""

from __future__ import annotations

import json
from pathlib import Path

import click

from rattlesweep.cli.common import command, say
from rattlesweep.errors import ConfigError, one_line


@command("Sweeps", "rattlesweep init mine.yaml")
@click.argument("config", type=click.Path(path_type=Path), default="sweep.yaml")
def init(config: Path) -> None:
    """Write a commented config to begin with, by default sweep.yaml, and print its path.

    It is a small sweep that runs as it is, with the name of the file. Nothing is overwritten.
    """
    from importlib.resources import files

    from rattlesweep.sweeps.config.read import parse_config, read_yaml
    from rattlesweep.sweeps.files import replace_file

    shown = one_line(str(config), 200)
    if config.suffix not in (".yaml", ".yml"):
        raise ConfigError(f"{shown}: the name of a config ends in .yaml; write {config.stem}.yaml")
    if config.exists():
        raise ConfigError(f"{shown}: is there already; choose another name, or remove it first")
    text = (files("rattlesweep.sweeps.config") / "starter.yaml").read_text(encoding="utf-8")
    name = config.stem
    # A name that YAML would read as something else, such as a number, stands in quotes.
    data, _, problems = read_yaml(f"name: {name}")
    quoted = name if data == {"name": name} and not problems else json.dumps(name)
    text = text.replace("name: NAME", f"name: {quoted}", 1).replace("NAME", name)
    parse_config(read_yaml(text)[0])  # a name may be none of a directory
    replace_file(config, text.encode())
    click.echo(config)
    say(f"run it: rattlesweep validate {shown}, rattlesweep run {shown}")
