"""What commands print by `--json` is what their schemas promise."""

from __future__ import annotations

import json
import math
from typing import Any

import jsonschema
import pytest
from refusal import assert_refused
from sweeping import invoke, sweep

from rattlesweep.cli.options import to_json
from rattlesweep.words.names import DOCUMENT_NAMES
from rattlesweep.words.units import readable_unit

STONE = ("--half-ellipsoid", "12cm,3cm,12mm", "--mass", "60g", "--skew", "3deg")
CONFIG = {
    "name": "mine",
    "model": "gh",
    "bodies": {"source": "sd", "samples": 3},
    "spin": {"n_i": -0.3, "omega_xy0": 0.01},
}


def schema_of(name: str) -> dict[str, Any]:
    schema = json.loads(invoke("schema", "--json", name).stdout)
    jsonschema.Draft202012Validator.check_schema(schema)
    return schema


def refuse(constant: str) -> None:
    raise ValueError(f"{constant} is no JSON")


def valid(name: str, *arguments: object) -> dict[str, Any]:
    """Return the document of a command, which its schema allows."""
    told = invoke(name, *arguments, "--json")
    assert told.exit_code == 0, told.stderr
    data = json.loads(told.stdout, parse_constant=refuse)
    jsonschema.validate(data, schema_of(name))
    return data


@pytest.mark.parametrize(
    "arguments",
    [
        ("--preset", "GH"),
        (*STONE, "--n-i", "-60rpm"),
        (*STONE, "--pivot", "54um", "--sigma", "1e-7 N m s", "--rolling", "1um"),
    ],
)
def test_bodies(arguments):
    data = valid("body", *arguments)
    assert ("units" in data) == (STONE[0] in arguments)
    assert ("pivot" in data) == ("--pivot" in arguments)
    # Theory has no threshold for this stone: null, and neither NaN nor Infinity.
    assert (data["n_c1"] is None) == (STONE[0] in arguments)


def test_patches_of_contact():
    data = valid("contact", *STONE, "--materials", "PLA,glass", "--facet", "0.4mm")
    assert data["units"]["mass"] == 0.06
    assert [each["E"] for each in data["materials"]] == [3.5e9, 70e9]
    assert len(data["remarks"]) == 2


def test_plans_and_progress(tmp_path):
    config = tmp_path / "mine.yaml"
    config.write_text(json.dumps(CONFIG))
    checked = valid("plan", config, "--check")
    assert checked == {"cases": 1, "samples": 3, "runs": 3}
    assert valid("plan", config).keys() > checked.keys()
    sweep(tmp_path / "out", CONFIG)
    data = valid("status", tmp_path / "out")
    assert (data["runs"], data["wanted"], data["status"]) == (3, 3, {"ok": 3})
    # The record of a session is declared in full.
    definition = schema_of("status")["$defs"]["Record"]
    assert data["last"].keys() == definition["properties"].keys()


def test_verdicts():
    launch = ("--spin", "60rpm", "--t-end", "2s")
    data = valid("verdict", *STONE, "--pivot", "54um", *launch)
    assert {run["outcome"] for run in data["runs"]} >= {"turns back"}
    # A reversal that did not come has no time.
    assert None in {run["t_s"] for run in data["runs"]}


def test_a_schema_says_what_each_key_is_and_allows_no_other():
    for name in DOCUMENT_NAMES:
        schema = schema_of(name)
        assert schema["description"].startswith("The output of")
        parts = [schema, *schema.get("$defs", {}).values()]
        for part in (part for part in parts if part["title"] != "Record"):
            assert part["additionalProperties"] is False
        with pytest.raises(jsonschema.ValidationError):
            jsonschema.validate({"more": 1}, schema)
    assert schema_of("body")["properties"]["K_p"]["unit"] == "1"
    assert schema_of("body")["properties"]["t_rgh"]["unit"] == "sqrt(a/g)"


def test_what_is_not_finite_is_null():
    data = {"a": [1, math.nan, (math.inf, True)], "b": {"c": -math.inf, "d": "x"}}
    wanted = {"a": [1, None, [None, True]], "b": {"c": None, "d": "x"}}
    assert json.loads(to_json(data), parse_constant=refuse) == wanted


def test_two_schemas_at_once_are_refused():
    assert_refused(invoke("schema", "--case", "--json", "body"), 2, "ask for one")
    assert_refused(invoke("schema", "--json", "bodies"), 2, "is not one of")


@pytest.mark.parametrize(
    ("size", "unit", "told"),
    [
        (0.00025, "m", "250 um"),
        (-5.9e-7, "m", "-590 nm"),
        (0.0, "m", "0 m"),
        (0.012, "m", "0.012 m"),
        (0.0002, "s", "0.0002 s"),
    ],
)
def test_short_lengths_are_told_in_units_that_people_use(size, unit, told):
    factor, readable = readable_unit(size, unit)
    assert f"{factor * size:g} {readable}" == told
