"""Commands print what is kept in `tests/net/transcripts.txt`; see `tests/net/make.py`."""

import importlib.util
from pathlib import Path
from typing import Any

spec = importlib.util.spec_from_file_location("net", Path(__file__).parents[1] / "net" / "make.py")
assert spec is not None
assert spec.loader is not None
net: Any = importlib.util.module_from_spec(spec)
spec.loader.exec_module(net)


def test_commands_print_what_is_kept(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sys.argv", [])
    monkeypatch.setenv("COLUMNS", "80")
    found, kept = (text.split("\n$ ") for text in (net.make(), net.FILE.read_text()))
    for one, other in zip(found, kept, strict=True):
        assert one == other
