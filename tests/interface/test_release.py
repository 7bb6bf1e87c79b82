"""What a release says of itself in several places."""

import json
import re
import tomllib

from sweeping import ROOT


def test_the_version_is_the_same_everywhere():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    version = project["version"]
    citation = (ROOT / "CITATION.cff").read_text()
    assert re.findall(r"^version: (.*)$", citation, re.MULTILINE) == [version]
    archive = json.loads((ROOT / ".zenodo.json").read_text())
    assert archive["version"] == version
    assert archive["license"] == project["license"]
    assert version in (ROOT / "CHANGELOG.md").read_text()


def test_the_newest_python_of_the_classifiers_is_tried_on_a_public_host():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    pythons = re.findall(r"Python :: (3\.\d+)", " ".join(project["classifiers"]))
    workflow = (ROOT / ".github" / "workflows" / "ci.yml").read_text()
    tried = re.search(r"python: \[(.*)\]", workflow)
    assert tried is not None
    assert re.findall(r"3\.\d+", tried[1]) == pythons
