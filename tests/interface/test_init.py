"""`rattlesweep init` writes a config that runs as it is, and overwrites nothing."""

import re

import pytest
from refusal import assert_refused
from ruamel.yaml import YAML
from sweeping import invoke

from rattlesweep.sweeps.config.read import load_config, parse_config
from rattlesweep.sweeps.config.schema import Config


@pytest.fixture(autouse=True)
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_it_runs_as_it_is(here):
    written = invoke("init", "mine.yaml")
    assert (written.exit_code, written.stdout) == (0, "mine.yaml\n")
    assert written.stderr == "run it: rattlesweep validate mine.yaml, rattlesweep run mine.yaml\n"
    valid = invoke("validate", "mine.yaml")
    assert (valid.exit_code, valid.stderr) == (0, "")
    assert load_config("mine.yaml").directory == "out/mine"
    assert invoke("run", "mine.yaml", "--set", "bodies.samples=2").exit_code == 0
    assert (here / "out" / "mine" / "summary.parquet").exists()
    text = (here / "mine.yaml").read_text()
    assert text.isascii()
    assert max(map(len, text.splitlines())) <= 120
    assert "NAME" not in text


def test_what_is_commented_out_is_true(here):
    """Defaults are the defaults, and other sources are valid."""
    invoke("init")
    text, yaml = (here / "sweep.yaml").read_text(), YAML(typ="safe")
    data = yaml.load(text)
    for line in re.findall(r"^ *# (\w+: .*?)(?:  +#.*)?$", text, re.MULTILINE):
        ((key, value),) = yaml.load(line).items()
        if key in Config.model_fields:
            with_it = parse_config({**data, key: value})
            if key not in ("record", "output"):
                assert with_it == parse_config(data)
        elif key in ("ranges", "psi"):
            section = {"ranges": "bodies", "psi": "spin"}[key]
            assert parse_config({**data, section: {**data[section], key: value}}) == parse_config(
                data
            )
    sources = re.findall(r"^ *# (\{source: .*?\})(?:  +#.*)?$", text, re.MULTILINE)
    assert len(sources) == 3
    for source in sources:
        parse_config({**data, "bodies": yaml.load(source)})


@pytest.mark.parametrize("name", ["12", "true", "a: b", "null"])
def test_any_name_of_a_file_is_a_name(here, name):
    assert invoke("init", f"{name}.yaml").exit_code == 0
    assert load_config(f"{name}.yaml").name == name


def test_it_refuses_in_a_sentence(here):
    (here / "mine.yaml").write_text("precious")
    assert_refused(invoke("init", "mine.yaml"), 2, "mine.yaml: is there already; choose another")
    assert (here / "mine.yaml").read_text() == "precious"
    assert_refused(invoke("init", "mine.txt"), 2, "mine.txt: the name of a config ends in .yaml")
    assert_refused(invoke("init", "no/where/mine.yaml"), 1, "no/where")
    assert sorted(p.name for p in here.iterdir()) == ["mine.yaml"]
