"""The command line itself: help, versions, completion, choices; and `body` and `schema`."""

import inspect
import json
import re
import subprocess
import sys
from typing import Any

import click
import jsonschema
import pytest
from click.testing import CliRunner
from refusal import assert_refused
from sweeping import CONFIGS, PROGRAM, invoke

import rattlesweep as rs
from rattlesweep import cli
from rattlesweep.cli.common import types
from rattlesweep.integrate.model import MODELS, WITH_TANGENT
from rattlesweep.analysis.onerun.channels import choose
from rattlesweep.analysis.onerun.figure import CURVES, SHOWN
from rattlesweep.analysis.plots.kinds import KINDS
from rattlesweep.sweeps.plan import make_plan
from rattlesweep.sweeps.config.schema import ACCURACIES
from rattlesweep.sweeps.config.read import config_json_schema, parse_config
from rattlesweep.sweeps.columns import RECORD_PARTS

HEAVY = {"numpy", "numba", "scipy", "pandas", "pyarrow", "pydantic", "tqdm", "matplotlib"}


def command_of(name: str) -> Any:
    return cli.main.get_command(click.Context(cli.main), name)


def test_help_lists_every_command_in_a_section():
    text = invoke("--help").stdout
    listed = re.findall(r"^  (\w+) ", text.split("--help ")[1], re.MULTILINE)
    assert sorted(listed) == sorted(cli.COMMANDS)
    assert re.findall(r"^(\w.*):$", text, re.MULTILINE) == [
        "Options", "Sweeps", "One run", "Pictures and pages", "Study",
    ]  # fmt: skip
    assert "Exit codes: 0 done" in text


@pytest.mark.parametrize("name", cli.COMMANDS)
def test_every_command_has_help_with_an_example(name):
    text = invoke(name, "--help").stdout
    assert re.search(rf"Examples?:\n +rattlesweep {name}\b", text)
    flags = {flag: p for p in command_of(name).params for flag in p.opts}
    for short, long in (("-o", "--output"), ("-j", "--threads"), ("-q", "--quiet")):
        assert flags.get(long) is flags.get(short), (name, long)


def test_the_package_its_help_and_its_configs_load_nothing_heavy():
    code = f"""if True:
        import sys, rattlesweep as rs
        rs.__version__
        from rattlesweep import cli
        cli.main(["--help"], standalone_mode=False)
        assert not {HEAVY} & set(sys.modules)
        from rattlesweep.sweeps.config.read import load_config
        load_config({str(CONFIGS / "quickstart.yaml")!r})
        assert not {HEAVY} - {{"pydantic"}} & set(sys.modules)
        # A function, and not the room of the same name.
        from rattlesweep import sweep
        assert callable(sweep)
    """
    subprocess.run([sys.executable, "-c", code], capture_output=True, check=True)


def test_choices_are_those_of_the_registries():
    models = list(types.MODELS.choices)
    assert models == [*(name for name in MODELS if name in models), "gh"]
    assert list(types.KINDS.choices) == list(KINDS)
    assert list(types.ACCURACIES.choices) == list(ACCURACIES)
    schema = json.dumps(config_json_schema())
    for choice in (types.MODELS, types.PSI, types.PRESETS):
        assert json.dumps(list(choice.choices)) in schema


@pytest.mark.parametrize("model", types.MODELS.choices)
def test_a_model_is_known_wherever_models_are_told_apart(model):
    # A name that is none of its channels would be refused.
    assert len(choose(["t", *SHOWN[model]], model)) == 1 + len(SHOWN[model])
    assert model in CURVES
    # Without a tangent there is no exponent to record.
    assert (model in WITH_TANGENT) != (model in RECORD_PARTS["lyapunov"])


def test_defaults_in_the_help_are_those_of_the_python_interface():
    options = {o.name: o.help for o in command_of("trajectory").params}
    method = inspect.signature(rs.trajectory).parameters["method"].default
    assert f"[default: {method}]" in options["method"]
    integrator = parse_config(
        {"bodies": {"source": "preset", "name": "GH"}, "spin": {"n_i": 0.1, "omega_xy0": 0.1}}
    ).integrator
    assert f"[default: {integrator.tol:g}]".replace("e-0", "e-") in options["tol"]


@pytest.mark.parametrize(
    ("typed", "hint"),
    [("rnu", "did you mean run?"), ("verfy", "did you mean verify?"), ("x", "--help lists those")],
)
def test_a_mistyped_command_is_told(typed, hint):
    result = invoke(typed)
    assert (result.exit_code, result.stdout) == (2, "")
    assert f"no such command: {typed}; {hint}" in result.stderr


def test_the_module_is_the_program():
    for program in ([PROGRAM], [sys.executable, "-m", "rattlesweep"]):
        said = subprocess.run([*program, "body", "--help"], capture_output=True, text=True).stdout
        assert said.startswith("Usage: rattlesweep body [OPTIONS]\n")


def test_version():
    first = f"rattlesweep, version {rs.__version__}\n"
    assert invoke("--version").stdout == first
    told = invoke("--version", "--verbose").stdout
    assert invoke("--verbose", "--version").stdout == told
    assert told.startswith(first)
    names = [line.split()[0] for line in told.splitlines()[1:]]
    assert {"numpy", "numba", "llvmlite", "cpu", "vectors", "threads"} <= set(names)


@pytest.mark.parametrize(
    ("typed", "completed"),
    [
        ("rattlesweep cl", ["plain,classify"]),
        ("rattlesweep trajectory --method d", ["plain,dop853", "plain,dopri5"]),
        ("rattlesweep plot out --kind ra", ["plain,ratio"]),
    ],
)
def test_completion(typed, completed):
    def complete(how: str) -> str:
        words = {"COMP_WORDS": typed, "COMP_CWORD": str(len(typed.split()) - 1)}
        environment = {"_RATTLESWEEP_COMPLETE": how, **words}
        return CliRunner().invoke(cli.main, env=environment, prog_name="rattlesweep").stdout

    assert complete("bash_complete").split() == completed
    assert "_RATTLESWEEP_COMPLETE=bash_complete" in complete("bash_source")


def test_the_schema_is_one_and_takes_the_shipped_configs():
    from ruamel.yaml import YAML

    schema = json.loads(invoke("schema").stdout)
    jsonschema.Draft202012Validator.check_schema(schema)
    validator = jsonschema.Draft202012Validator(schema)
    for path in CONFIGS.glob("*.yaml"):
        data = YAML(typ="safe", pure=True).load(path.read_text())
        validator.validate(data)
        make_plan(parse_config(data | {"bodies": data["bodies"] | (
            {"samples": 1} if data["bodies"]["source"] == "sd" else {})}))  # fmt: skip
    assert not validator.is_valid({"bodies": {"source": "sd"}, "spin": {"n_i": 0}})


# -- one body ----------------------------------------------------------------------------------


def test_body_says_what_the_python_interface_says():
    gh = rs.Rattleback.gh()
    found = json.loads(invoke("body", "--preset", "GH", "--n-i", "-0.1", "--json").stdout)
    modes = rs.modes(gh)
    for name, value in vars(modes).items():
        assert found[name] == value
    for name in ("alpha", "beta", "gamma", "theta", "phi", "xi"):
        assert found[name] == getattr(gh, name)
    assert found["t_rgh"] == rs.reversal_time_gh(gh, -0.1, 0.01)
    assert found["psi"] == modes.psi_r
    table = invoke("body", "--preset", "GH", "--n-i", "-0.1").stdout.splitlines()
    assert [line.split()[0] for line in table] == list(found)
    for line in table:
        name, value = line.split()[:2]
        shown = None if value == "none" else pytest.approx(float(value), rel=1e-9)
        assert found[name] == shown or (found[name] is None and value == "none")


WRONG = """
: --alpha, --beta, --gamma, --theta, --phi, --xi missing
--alpha 3 --gamma 5: --beta, --theta, --phi, --xi missing
--f-sd 0.1 --gamma 5: --theta, --phi, --xi missing
--preset GH --f-sd 0.1: --f-sd does not go with --preset
--preset GH --xi -0.1 --xi-deg -3: --xi and --xi-deg are both given
--alpha 3 --f-sd 0.1: --f-sd replaces --alpha and --beta
--preset GH --phi 0.7: phi 0.7 is not below theta 0.6429
--preset GH --theta nan: a parameter is not a finite number
--preset GH --n-i 0: --n-i 0: the initial spin must be finite and not zero
--preset GH --n-i inf: --n-i inf: the initial spin must be finite and not zero
--preset GH --omega-xy0 -1: --omega-xy0 -1: the oscillation must be finite and pos
--gamma 10 --f-sd 0.7 --theta 0.8 --phi 0.05 --xi -0.1: f_sd is 0.7; it must lie
"""


@pytest.mark.parametrize("line", WRONG.strip().splitlines())
def test_a_wrong_body_is_one_sentence(line):
    args, words = line.split(": ", 1)
    assert_refused(invoke("body", *args.strip(":").split()), 2, words)
