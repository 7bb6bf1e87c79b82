"""What comes with the code: example configs, and the pages of the documentation."""

import json
import re
from importlib.resources import files
from importlib.resources.abc import Traversable
from pathlib import Path

ALIASES = {"map": "map_theta_spin"}
"""Examples whose file has a longer name."""


def examples_folder() -> Traversable:
    """Return the folder of the example configs: of the package, or of the clone."""
    return _packaged("examples", "configs")


def documentation() -> dict[str, str]:
    """Return the pages of the documentation: Markdown by name, in order of the names.

    Files that only their directory has, such as pictures, are not among them.
    """
    pages = {
        entry.name.removesuffix(".md"): entry.read_text(encoding="utf-8")
        for entry in _packaged("pages", "docs").iterdir()
        if entry.name.endswith(".md")
    }
    return dict(sorted(pages.items()))


def _packaged(name: str, original: str) -> Traversable:
    package = files("rattlesweep")
    packaged = package / name
    if packaged.is_dir():
        return packaged
    # A clone has the only copy, which the wheel takes from there (see pyproject.toml).
    return Path(str(package)).parent / original


def example_names() -> list[str]:
    """Return the names of the examples, one for each config or folder."""
    folder = examples_folder()
    if not folder.is_dir():
        return []
    names = {entry.name.removesuffix(".yaml") for entry in folder.iterdir()}
    return sorted(names - set(ALIASES.values()) | set(ALIASES))


def example_files(name: str, config: Path | None = None) -> dict[Path, str]:
    """Return the files of an example: paths to write them to, with their texts.

    By default they go to ``configs``, as in the clone, so that the commands of the
    documentation hold there too; `config` is another path for the config.
    """
    entry = examples_folder() / ALIASES.get(name, name)
    directory = Path("configs")
    if entry.is_dir():
        # A stone and its data, which stay together.
        directory /= entry.name
        sources = sorted(entry.iterdir(), key=lambda file: file.name)
    else:
        sources = [examples_folder() / f"{entry.name}.yaml"]
    places = {source.name: directory / source.name for source in sources}
    targets = dict(places)
    if config is not None:
        for file in places:
            targets[file] = config if file.endswith(".yaml") else config.with_name(file)
    texts: dict[Path, str] = {}
    for source in sources:
        text = linked(source.read_text(encoding="utf-8"))
        # The commands in the comments name the files that are written.
        for file, place in places.items():
            text = text.replace(place.as_posix(), targets[file].as_posix())
        texts[targets[source.name]] = text
    return texts


def starter(name: str) -> str:
    """Return the commented config to begin with, of a sweep with this name."""
    source = files("rattlesweep.config") / "starter.yaml"
    text = linked(source.read_text(encoding="utf-8"))
    # In quotes, as YAML would read some names as numbers.
    text = text.replace("name: NAME", f"name: {json.dumps(name)}")
    return text.replace("NAME", name)


def linked(text: str) -> str:
    """Return a text with commands in place of pages such as ``docs/types.md``."""
    return re.sub(r"docs/(\w+)\.md", r"`rattlesweep docs \1`", text)
