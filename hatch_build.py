"""Hooks of Hatchling: README.md is the long description, and pages of docs/ come along.

On a package index, a link such as ``docs/tutorial.md`` leads nowhere.  Pages and
pictures of docs/ are linked to on the site, other files in the repository, both at the
addresses of ``[project.urls]``.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface
from hatchling.metadata.plugin.interface import MetadataHookInterface


class LongDescription(MetadataHookInterface):
    """The long description, from README.md."""

    def update(self, metadata: dict[str, Any]) -> None:
        """Set the key `readme` of the metadata."""
        markdown = Path(self.root, "README.md").read_text(encoding="utf-8")
        urls = metadata["urls"]
        text = published(markdown, urls["Documentation"], urls["Repository"])
        metadata["readme"] = {"content-type": "text/markdown", "text": text}


class Pages(BuildHookInterface):
    """The Markdown of docs/ in the wheel, for `rattlesweep docs`."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Add the pages; a wheel of an editable installation needs none."""
        if version == "editable":
            return
        for page in Path(self.root, "docs").glob("*.md"):
            build_data["force_include"][str(page)] = f"rattlesweep/pages/{page.name}"


def published(markdown: str, site: str, repository: str) -> str:
    """Return the Markdown with absolute links."""

    def absolute(match: re.Match[str]) -> str:
        path, anchor = match[1], match[2] or ""
        if path.startswith("docs/"):
            page = re.sub(r"(/index)?\.md$", "/", path.removeprefix("docs"))
            return f"]({site}{page}{anchor})"
        return f"]({repository}/blob/main/{path}{anchor})"

    return re.sub(r"\]\(([^):#\s]+)(#[^)\s]*)?\)", absolute, markdown)
