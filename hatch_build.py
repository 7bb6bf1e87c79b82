"""A hook of Hatchling that makes README.md the long description of the package.

On a package index, a link such as ``docs/tutorial.md`` leads nowhere.  Pages and
pictures of docs/ are linked to on the site, other files in the repository, both at the
addresses of ``[project.urls]``.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from hatchling.metadata.plugin.interface import MetadataHookInterface


class LongDescription(MetadataHookInterface):
    """The long description, from README.md."""

    def update(self, metadata: dict[str, Any]) -> None:
        """Set the key `readme` of the metadata."""
        markdown = Path(self.root, "README.md").read_text(encoding="utf-8")
        urls = metadata["urls"]
        text = published(markdown, urls["Documentation"], urls["Repository"])
        metadata["readme"] = {"content-type": "text/markdown", "text": text}


def published(markdown: str, site: str, repository: str) -> str:
    """Return the Markdown with absolute links."""

    def absolute(match: re.Match[str]) -> str:
        path, anchor = match[1], match[2] or ""
        if path.startswith("docs/"):
            page = re.sub(r"(/index)?\.md$", "/", path.removeprefix("docs"))
            return f"]({site}{page}{anchor})"
        return f"]({repository}/blob/main/{path}{anchor})"

    return re.sub(r"\]\(([^):#\s]+)(#[^)\s]*)?\)", absolute, markdown)
