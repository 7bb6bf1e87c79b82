"""What a user sees is what is kept in `tests/net`; see `tests/net/make.py`."""

import importlib.util
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


def test_it_notices_a_last_bit_and_a_word(found, monkeypatch, tmp_path):
    # As if made on this machine.
    monkeypatch.setattr(net, "HERE", tmp_path)
    for name, text in found.items():
        (tmp_path / name).write_text(text)
    assert net.compare(found) == []
    for name, old, new in (
        ("hashes.json", '"t_r": "', '"t_r": "x'), ("help.txt", "Exit codes", "Codes")
    ):  # fmt: skip
        assert net.compare({**found, name: found[name].replace(old, new, 1)})


@pytest.mark.slow
def test_methods_models_the_study_and_the_paper(tmp_path):
    assert "".join(net.compare(net.make(net.slow, tmp_path))) == ""
