"""What a user sees is what is kept in `tests/net`; see `tests/net/make.py`."""

from __future__ import annotations

import importlib.util
import json
from pathlib import Path
from typing import Any

import pytest

spec = importlib.util.spec_from_file_location("net", Path(__file__).parents[1] / "net" / "make.py")
assert spec is not None
assert spec.loader is not None
net: Any = importlib.util.module_from_spec(spec)
spec.loader.exec_module(net)


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    return net.make(net.quick, tmp_path_factory.mktemp("net"))


def test_a_user_sees_what_is_kept(found):
    assert "".join(net.compare(found)) == ""


def test_on_another_machine_the_words_are_compared(found, monkeypatch):
    monkeypatch.setattr(net, "machine", lambda: {"cpu": "another"})
    text = found["commands.txt"]
    slightly = text.replace("0.694362", "0.694363").replace("16.54", " 16.55")
    assert net.compare({**found, "commands.txt": slightly}) == []
    assert net.compare({**found, "commands.txt": text.replace("reversal", "return", 1)})


def test_it_notices_a_last_bit_and_a_word(found, monkeypatch):
    made_on = json.loads((net.HERE / "hashes.json").read_text())["made_on"]
    monkeypatch.setattr(net, "machine", lambda: made_on)
    assert net.compare(
        {**found, "hashes.json": found["hashes.json"].replace('"t_r": "', '"t_r": "x', 1)}
    )
    assert net.compare({**found, "help.txt": found["help.txt"].replace("Exit codes", "Codes")})


@pytest.mark.slow
def test_methods_models_the_study_and_the_paper(tmp_path):
    assert "".join(net.compare(net.make(net.slow, tmp_path))) == ""
