"""What the site has beside docs/*.md: pages of the root, and `--help` of every command.

A hook of MkDocs (see mkdocs.yml).
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import click
from mkdocs.structure.files import File

from rattlesweep.cli import main

ROOT = Path(__file__).resolve().parent.parent
COPIED = {"CONTRIBUTING.md": "contributing.md", "CHANGELOG.md": "changelog.md"}


def on_files(files: Any, *, config: Any) -> Any:
    """Add pages that are no files of docs/."""
    for source, name in COPIED.items():
        text = (ROOT / source).read_text(encoding="utf-8").replace("](docs/", "](")
        files.append(File.generated(config, name, content=text))
    files.append(File.generated(config, "commands.md", content=commands()))
    return files


def on_page_markdown(markdown: str, **rest: Any) -> str:
    """Let links to files of the root lead to their pages."""
    for source, name in {**COPIED, "README.md": "index.md"}.items():
        markdown = re.sub(rf"\]\((\.\./)?{re.escape(source)}", f"]({name}", markdown)
    return markdown


def commands() -> str:
    """One page of all that `--help` says."""
    parts = ["# Commands", "`rattlesweep COMMAND --help` prints the same."]
    with click.Context(main, info_name="rattlesweep") as context:
        parts.append(f"```text\n{main.get_help(context)}\n```")
        for name in main.list_commands(context):
            command = main.get_command(context, name)
            assert command is not None
            with click.Context(command, info_name=name, parent=context) as own:
                parts.append(f"## {name}\n\n```text\n{command.get_help(own)}\n```")
    return "\n\n".join(parts) + "\n"
