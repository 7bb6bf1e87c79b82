"""Commands that change an output directory, to be killed or failed at each call they make there."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import pyarrow as pa
from hardship import (
    OTHER_TYPES,
    Ended,
    Reference,
    check_finished,
    check_whole,
    manifest,
    nursery,
    tiny,
    trace,
)

from rattlesweep.sweeps.old.manifest import Manifest
from rattlesweep.sweeps.old.store import Store
from rattlesweep.sweeps.columns import runs_schema

SCENES = ("run", "classify", "retry", "fresh", "merge", "grow")


def finished_sweep(folder: Path, *lines: str, **changes: Any) -> tuple[Path, Path, Reference]:
    """A config (see `tiny`), its sweep, and that remembered."""
    config, output = tiny(folder, *lines, **changes), folder / "whole"
    assert nursery().run("run", config, "--output", output, "-q").code == 0
    return config, output, Reference.of(output)


@dataclass(frozen=True)
class Scene:
    """A command, ``{out}`` in it for the directory, which is a copy of `before` each time."""

    before: Path | None
    command: tuple[Any, ...]
    after: Reference
    others: tuple[Reference, ...] = ()

    def begin(self, output: Path) -> list[str]:
        """Put the directory there, and say the command."""
        shutil.rmtree(output, ignore_errors=True)
        if self.before is not None:
            shutil.copytree(self.before, output)
        return [str(part).replace("{out}", str(output)) for part in self.command]


def make_scene(name: str, folder: Path, **changes: Any) -> Scene:
    """One of `SCENES`, on a sweep of two blocks: more pass through the same calls."""
    config, whole, reference = finished_sweep(folder, **({"block_size": 12} | changes))
    run = ("run", config, "--output", "{out}", "-q")

    def did(command: tuple[Any, ...], output: Path) -> Path:
        done = nursery().run(*(str(part).replace("{out}", str(output)) for part in command))
        assert done.code == 0, done
        return output

    if name == "run":
        return Scene(None, run, reference)
    if name == "merge":
        shards = [did((*run, "--shard", f"{k}/2"), folder / str(k)) for k in range(2)]
        command: tuple[Any, ...] = ("merge", *shards, "--output", "{out}")
        return Scene(None, command, Reference.of(did(command, folder / "merged")))
    if name == "classify":
        before, command = whole, ("classify", "{out}", "--set", OTHER_TYPES)
    elif name == "grow":
        before = did((*run, "--set", "spin.n_i=-0.1"), folder / "smaller")
        command = run
    elif name == "fresh":
        before, command = did((*run, "--set", "seed=1"), folder / "other"), (*run, "--fresh")
    else:
        before, command = Path(shutil.copytree(whole, folder / "failed")), (*run, "--retry-failed")
        _fail_some(before)
    after = did(command, Path(shutil.copytree(before, folder / "after")))
    references = Reference.of(after), Reference.of(before)
    assert references[0].hash != references[1].hash
    assert (references[0].hash == reference.hash) == (name != "classify")
    return Scene(before, command, references[0], references[1:])


def _fail_some(directory: Path) -> None:
    """Make of a finished sweep one in which every third run came to its limit of steps."""
    store, said = Store(directory), manifest(directory)
    receipts = {}
    for index in store.block_indices():
        file = store.read_block(index)
        columns = file.table().to_pydict()
        for row, sample in enumerate(columns["sample"]):
            if sample % 3 == 1:
                columns["status"][row] = "step_limit"
                columns["type"][row] = columns["t_r"][row] = None
        rows = pa.table(columns, schema=runs_schema(model="gh"))
        assert file.note is not None
        receipts[index] = store.write_block(index, rows, replace(file.note, max_steps=10))
    said["config"]["integrator"]["max_steps"] = 10
    changed = Manifest.parse(said)
    changed.receipts = receipts
    changed.add_up()
    store.write_manifest(changed)


def at_every_call(
    scene: Scene,
    folder: Path,
    kinds: tuple[str, ...],
    judge: Callable[[Ended, Path], bool],
    stride: int = 1,
    **harm: Any,
) -> int:
    """Do harm at one call of the command after the other, look, and give it again; how often."""
    output = folder / "out"
    calls = trace(output, folder / "log", *scene.begin(output), kinds=kinds)
    check_finished(output, scene.after)
    places = range(0, len(calls), stride)
    for at in places:
        args = scene.begin(output)
        done = nursery().run(*args, calls={"root": output, "kinds": kinds, "at": at, **harm})
        where = f"{harm} at call {at}, {calls[at]}: {done}"
        assert judge(done, output), where
        if output.exists():
            check_whole(output, scene.after, *scene.others)
        again = nursery().run(*args)
        assert again.code == 0, (where, again)
        check_finished(output, scene.after)
    args = scene.begin(output)
    beyond = {"root": output, "kinds": kinds, "at": len(calls), **harm}
    assert nursery().run(*args, calls=beyond).code == 0
    return len(places)
