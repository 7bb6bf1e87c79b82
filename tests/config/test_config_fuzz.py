"""Whatever is done to a config, it is either accepted or refused in plain sentences."""

import json
import re
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from ruamel.yaml import YAML
from test_config import GOOD

from rattlesweep.errors import ConfigError
from rattlesweep.sweeps.config.load import load_config, parse_config, physics_hash, resolved
from rattlesweep.sweeps.config.schema import Config

JARGON = ("Traceback", "pydantic", "Input should", "ruamel", "http", "<class", "object at")
QUICK = settings(
    max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)

texts = st.sampled_from(sorted(GOOD.values()))
keys = st.sampled_from(
    # Real keys, so that pieces end up where others are wanted.
    sorted({*re.findall(r"[A-Za-z]\w*", " ".join(GOOD.values())), "alpha", "K_p", "xi"})
)
scalars = (
    st.none()
    | st.booleans()
    | st.integers()
    | st.integers(-2, 3)
    | st.floats()
    | st.sampled_from([0.5, -0.1, 1e-9, "1e-9", "1_000", "sd", "GH", "rk4", "grid", "relevant"])
    | st.text(max_size=12)
)
values = st.recursive(
    scalars,
    lambda inner: (
        st.lists(inner, max_size=4) | st.dictionaries(keys | st.text(max_size=5), inner, max_size=4)
    ),
    max_leaves=8,
)
plain_data = {name: YAML(typ="safe", pure=True).load(text) for name, text in GOOD.items()}


def check(read: Callable[[], Config]) -> None:
    refusal = None
    try:
        config = read()
    except ConfigError as error:
        refusal = error
    if refusal is None:
        data = resolved(config)
        assert resolved(parse_config(json.loads(json.dumps(data, allow_nan=False)))) == data
        assert len(physics_hash(config)) == 64
        return
    assert refusal.messages
    for line in refusal.messages:
        assert line.isprintable(), line
        # What the user wrote may say anything: it stands in quotes, or in front as --set or key.
        own_words = "".join(line.split('"')[::2])
        assert not any(word in own_words for word in JARGON), line
        line.encode()


@pytest.fixture(scope="module")
def path() -> Any:
    with tempfile.TemporaryDirectory() as directory:
        yield Path(directory) / "c.yaml"


@QUICK
@given(texts, st.data())
def test_broken_text(path: Path, text: str, data: st.DataObject) -> None:
    """Characters or lines dropped, doubled, inserted; the end cut off."""
    for _ in range(data.draw(st.integers(1, 4))):
        start = data.draw(st.integers(0, len(text)))
        end = data.draw(st.integers(start, min(len(text), start + 20)))
        new = data.draw(
            st.text(max_size=6)
            | st.text("{}[]:,-?&*!|>'\"%@`#~ \t\n\\.0e<", max_size=6)
            | keys
            | st.just(text[start:end] * 2)
        )
        text = text[:start] + new + text[end:]
    lines = text.split("\n")
    line = data.draw(st.sampled_from(lines))
    lines.insert(data.draw(st.integers(0, len(lines))), line)
    text = "\n".join(lines)[: data.draw(st.integers(0, 2000))]
    path.write_bytes(text.encode("utf-8", "surrogatepass"))
    check(lambda: load_config(path))


@QUICK
@given(st.binary(max_size=200), texts, st.integers(0, 400))
def test_bytes(path: Path, raw: bytes, text: str, place: int) -> None:
    old = text.encode()
    for content in (raw, old[:place] + raw + old[place:]):
        path.write_bytes(content)
        check(lambda: load_config(path))


@QUICK
@given(texts, st.data())
def test_settings(path: Path, text: str, data: st.DataObject) -> None:
    path.write_text(text, encoding="utf-8")
    dotted = st.lists(keys | st.text(max_size=5), max_size=3).map(".".join)
    value = values.map(lambda v: json.dumps(v, default=str)) | st.text(max_size=10)
    one = st.tuples(dotted, st.sampled_from(["=", "", " = "]), value).map("".join)
    overrides = data.draw(st.lists(one | st.text(max_size=20), min_size=1, max_size=4))
    check(lambda: load_config(path, overrides))


@QUICK
@given(st.sampled_from(sorted(plain_data)), st.data())
def test_broken_data(name: str, data: st.DataObject) -> None:
    """Keys dropped, renamed or added, and values of other types, at any depth."""
    config: Any = json.loads(json.dumps(plain_data[name]))
    for _ in range(data.draw(st.integers(1, 3))):
        here = config
        while True:
            places = list(here) if isinstance(here, dict) else list(range(len(here)))
            if not places:
                break
            place = data.draw(st.sampled_from(places))
            if isinstance(here[place], dict | list) and data.draw(st.integers(0, 3)):
                here = here[place]
                continue
            change = data.draw(st.sampled_from(["drop", "rename", "replace", "replace", "add"]))
            if change == "replace":
                here[place] = data.draw(values)
            elif change == "drop":
                del here[place]
            elif isinstance(here, list):
                here.append(data.draw(values))
            elif change == "rename":
                here[data.draw(keys)] = here.pop(place)
            else:
                here[data.draw(keys)] = data.draw(values)
            break
    check(lambda: parse_config(config))


@QUICK
@given(values)
def test_any_data(data: Any) -> None:
    check(lambda: parse_config(data))
    check(lambda: parse_config({"bodies": data, "spin": data, "integrator": data}))
    check(lambda: parse_config({"bodies": {"source": "grid", "base": data, "axes": data}}))
    spin = {"n_i": 1, "omega_xy0": 1}
    axes = {"theta": data, "xi": data}
    bodies = {"source": "grid", "base": {"preset": "GH"}, "axes": axes}
    check(lambda: parse_config({"bodies": bodies, "spin": spin}))
