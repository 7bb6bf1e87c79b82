"""What a release says of itself in several places."""

import json
import re
import tomllib
from importlib.metadata import version

from ruamel.yaml import YAML
from sweeping import ROOT

import rattlesweep as rs


def test_the_version_is_that_of_the_package_everywhere():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert "version" in project["dynamic"]
    assert "version" not in project
    citation = (ROOT / "CITATION.cff").read_text()
    assert re.findall(r"^version: (.*)$", citation, re.MULTILINE) == [rs.__version__]
    archive = json.loads((ROOT / ".zenodo.json").read_text())
    assert archive["version"] == rs.__version__
    assert archive["license"] == project["license"]
    heading = rf"^## {re.escape(rs.__version__)}(,|$)"
    assert re.search(heading, (ROOT / "CHANGELOG.md").read_text(), re.MULTILINE)


def test_the_environment_of_conda_has_what_the_package_needs():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())
    environment = YAML(typ="safe").load(ROOT / "environment.yml")
    wanted = {
        f"python{project['project']['requires-python']}",
        "pip",
        *project["build-system"]["requires"],
        *project["project"]["dependencies"],
    }
    listed = {line.replace(" ", "") for line in environment["dependencies"]}
    assert {line.replace("-base", "") for line in listed} == wanted


def test_the_installed_package_has_the_version_of_the_sources():
    """If this fails after a change of the version, install the package again."""
    assert version("rattlesweep") == rs.__version__


def test_the_newest_python_of_the_classifiers_is_tried_on_a_public_host():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    pythons = re.findall(r"Python :: (3\.\d+)", " ".join(project["classifiers"]))
    workflow = (ROOT / ".github" / "workflows" / "ci.yml").read_text()
    tried = re.search(r"python: \[(.*)\]", workflow)
    assert tried is not None
    assert re.findall(r"3\.\d+", tried[1]) == pythons
