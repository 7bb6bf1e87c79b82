"""The pages of docs/ that are written from the code are current and true; imports obey
the plan.
"""

import importlib.util
import re
import subprocess
import sys
from pathlib import Path

import pytest
from ruamel.yaml import YAML
from sweeping import invoke

import rattlesweep as rs
from rattlesweep.analysis.fit import joint, result
from rattlesweep.config.read import load_config, parse_config
from rattlesweep.design.plan import make_plan
from rattlesweep.rows import columns
from rattlesweep.words import quantities
from rattlesweep.words.units import KINDS, quantity

ROOT = Path(__file__).parents[2]
SCRIPT = ROOT / "docs" / "make_reference.py"


@pytest.fixture
def make(monkeypatch):
    spec = importlib.util.spec_from_file_location("make_reference", SCRIPT)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    monkeypatch.setattr(sys, "argv", ["make_reference.py", "--check"])
    return module


def test_the_pages_are_current_and_old_ones_are_told(
    make, tmp_path, monkeypatch, capsys
):
    assert make.main() == 0
    assert capsys.readouterr().err == ""
    for name in ("columns.md", "config.md"):
        (tmp_path / name).write_text(
            (ROOT / "docs" / name).read_text().replace("first", "last")
        )
    monkeypatch.setattr(make, "DOCS", tmp_path)
    assert make.main() == 1
    assert "run python docs/make_reference.py" in capsys.readouterr().err


@pytest.mark.parametrize("option", ["--help", "--chekc"])
def test_help_and_wrong_options_write_no_page(make, option, tmp_path, monkeypatch):
    monkeypatch.setattr(make, "DOCS", tmp_path)
    monkeypatch.setattr(sys, "argv", ["make_reference.py", option])
    with pytest.raises(SystemExit):
        make.main()
    assert not list(tmp_path.iterdir())


def test_the_page_on_calls_has_every_public_name():
    """Each name of `rs` is in a table, and in the list of docstrings of the site."""
    names = {name for name in rs.__all__ if not name.startswith("_")}
    text = (ROOT / "docs" / "docstrings.txt").read_text()
    listed = set(re.findall(r"^ +- (\w+)$", text, re.MULTILINE))
    listed |= set(re.findall(r"^::: .*\.(\w+)$", text, re.MULTILINE))
    assert names <= listed
    page = (ROOT / "docs" / "api.md").read_text()
    assert names <= set(re.findall(r"`(\w+)`", page))
    assert ":::" not in page


def test_each_public_name_says_how_stable_it_is():
    page = (ROOT / "docs" / "api.md").read_text()
    levels = re.findall(r"`([a-z ]+)`:", page)
    public = [getattr(rs, name) for name in rs.__all__ if not name.startswith("_")]
    public += [joint.JointFit, result.Fit]
    modules = re.findall(r"`(rattlesweep\.[\w.]+)`", page)
    assert len(modules) > 4
    public += map(importlib.import_module, modules)
    for each in public:
        (level,) = re.findall(r"^ *Stability: (.*)\.$", each.__doc__, re.MULTILINE)
        assert level in levels, each


def test_every_example_is_valid(make):
    """Each example of a section is a part of a config; it is tried with the rest that
    it needs.
    """
    for path, examples in make.EXAMPLES.items():
        for part in map(YAML(typ="safe").load, examples):
            spin = {"spin": {"n_i": "0.1 sqrt(g/a)", "omega_xy0": "0.01 sqrt(g/a)"}}
            rest = {"horizon": {"t": 10}} if "launch" in part else spin
            parse_config({"bodies": {"source": "sd"}, **rest, **part})
            assert path.split(",")[0].split(".")[0] in part


def test_the_config_at_the_head_and_the_table_run(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    text = (ROOT / "docs" / "config.md").read_text()
    (tmp_path / "head.yaml").write_text(
        re.findall(r"```yaml\n(.*?)```", text, re.DOTALL)[0]
    )
    assert make_plan(load_config("head.yaml")).runs == 27_000
    (csv,) = re.findall(r"```csv\n(.*?)```", text, re.DOTALL)
    (tmp_path / "bodies.csv").write_text(csv)
    for source, output in (("bodies.csv", "out/one"), ("out/one/runs", "out/two")):
        (tmp_path / "table.yaml").write_text(
            f"bodies: {{source: table, path: {source}}}\n"
            "horizon: {t: 50}\n"
            f"output: {output}\n"
        )
        assert invoke("run", "table.yaml").exit_code == 0


def test_every_quantity_is_named_once_and_columns_agree():
    for name, definition in quantities.QUANTITIES.items():
        assert name == definition.name
        assert definition.low < definition.high
        assert not definition.kind or definition.kind in KINDS
        if definition.measure is not None:
            # Its unit is one of its kind.
            measured = f"1 {definition.measure.unit}"
            size = quantity(measured, definition.kind)
            assert size == pytest.approx(definition.measure.size, rel=1e-15)
    for column in columns.COLUMNS.values():
        assert (column.name in quantities.QUANTITIES) != bool(column.meaning)
        assert (
            columns.define(column.name).unit == column.field.metadata[b"unit"].decode()
        )
    assert columns.define("n_i_rpm").symbol == "$n_{i}$"


PAGES = (ROOT / "README.md", *ROOT.glob("docs/*.md"), *ROOT.glob("benchmarks/*.md"))


@pytest.mark.parametrize(
    "page", sorted(path.relative_to(ROOT).as_posix() for path in PAGES)
)
def test_links_between_pages_lead_somewhere(page):
    text = (ROOT / page).read_text()
    for path, anchor in re.findall(r"\]\(([^)#\s]+)(#[^)\s]*)?\)", text):
        if "://" in path:
            continue
        file = ((ROOT / page).parent / path).resolve()
        assert file.exists(), f"{page}: {path}"
        if anchor and file.suffix == ".md":
            heads = re.findall(r"^#+ (.*)$", file.read_text(), re.MULTILINE)
            slugs = {
                re.sub(r"[^\w\- ]", "", h.lower()).strip().replace(" ", "-")
                for h in heads
            }
            assert anchor[1:] in slugs, f"{page}: {path}{anchor}"


def test_the_manuscript_names_what_exists():
    """Its numbers come from files of the repository, its citations from its list."""
    folder = ROOT / "docs" / "joss"
    text = (folder / "paper.md").read_text()
    comments = " ".join(re.findall(r"<!--(.*?)-->", text, re.DOTALL))
    paths = re.findall(r"\b(?:benchmarks|configs|docs|tests)/[\w/.]+\w", comments)
    assert len(paths) > 10
    assert all((ROOT / path).exists() for path in paths)
    (picture,) = re.findall(r"\]\((\S+\.png)\)", text)
    assert (folder / picture).exists()
    keys = re.findall(
        r"^@\w+\{(\w+),", (folder / "paper.bib").read_text(), re.MULTILINE
    )
    assert set(re.findall(r"@(\w+)", text)) == set(keys)


def test_the_contracts_of_imports_hold():
    program = Path(sys.executable).with_name("lint-imports")
    done = subprocess.run(
        [program, "--no-cache"], cwd=ROOT, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stdout + done.stderr
