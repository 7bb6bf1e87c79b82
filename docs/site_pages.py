"""Add pages of the root and of benchmarks/, and the text of `--help`, to the site.

A hook of MkDocs (see mkdocs.yml).
"""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import Any

import click
from mkdocs.structure.files import File

from rattlesweep.cli import main

ROOT = Path(__file__).resolve().parent.parent
COPIED = {
    "CONTRIBUTING.md": "contributing.md",
    "CODE_OF_CONDUCT.md": "conduct.md",
    "CHANGELOG.md": "changelog.md",
    "benchmarks/README.md": "measurements.md",
    "benchmarks/extremes.md": "extremes.md",
    "benchmarks/claims.md": "claims.md",
    "benchmarks/claims_in_short.md": "claims_in_short.md",
    "benchmarks/engines.md": "engine_runs.md",
    "benchmarks/estimates.md": "estimates.md",
    "benchmarks/friction.md": "friction_checks.md",
    "benchmarks/kernel.md": "kernel.md",
    "benchmarks/shaken.md": "shaken_runs.md",
    "benchmarks/one_way.md": "one_way_tables.md",
    "benchmarks/fit.md": "fit_coverage.md",
    "benchmarks/literature.md": "other_runs.md",
}


def on_config(config: Any) -> Any:
    """Take the addresses of the site and the repository from pyproject.toml."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    config.site_url = project["project"]["urls"]["Documentation"]
    config.repo_url = project["project"]["urls"]["Repository"]
    return config


def on_files(files: Any, *, config: Any) -> Any:
    """Add the pages that are not in docs/."""
    for source, name in COPIED.items():
        path = ROOT / source
        links = path.read_text(encoding="utf-8")
        files.append(File.generated(config, name, content=relinked(links, path.parent)))
    files.append(File.generated(config, "commands.md", content=commands()))
    return files


def on_page_markdown(markdown: str, *, page: Any, **rest: Any) -> str:
    """Point links to files outside docs/ at their pages; add docstrings to api.md."""
    if page.file.src_uri == "api.md":
        markdown += (ROOT / "docs" / "docstrings.txt").read_text(encoding="utf-8")
    return relinked(markdown, ROOT / "docs")


def relinked(markdown: str, folder: Path) -> str:
    """Return the Markdown of a file in `folder` with links that lead to pages of the
    site.
    """

    def place(match: re.Match[str]) -> str:
        target = (folder / match[1]).resolve()
        if not target.is_relative_to(ROOT):
            return match[0]
        path = target.relative_to(ROOT).as_posix()
        return f"]({COPIED.get(path, path.removeprefix('docs/'))}{match[2] or ''})"

    return re.sub(r"\]\(([^)#:\s]+\.md)(#[^)\s]*)?\)", place, markdown)


def commands() -> str:
    """Return a page with the output of `--help` of every command."""
    parts = ["# Commands", "`rattlesweep COMMAND --help` prints the same."]
    with click.Context(main, info_name="rattlesweep") as context:
        parts.append(f"```text\n{main.get_help(context)}\n```")
        for name in main.list_commands(context):
            command = main.get_command(context, name)
            assert command is not None
            with click.Context(command, info_name=name, parent=context) as own:
                parts.append(f"## {name}\n\n```text\n{command.get_help(own)}\n```")
    return "\n\n".join(parts) + "\n"
