"""All losses, in every way to ask for them: the same rows, and the same refusals."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field
from typing import Any

import pandas as pd
import pytest
from click.testing import CliRunner

import rattlesweep as rs
from rattlesweep.cli import main
from rattlesweep.config.read import parse_config, physics_hash
from rattlesweep.design.bodies.table import frame_bodies
from rattlesweep.design.plan import make_plan
from rattlesweep.physics.body import PARAMETERS
from rattlesweep.words.quantities import LOSSES


@dataclass(frozen=True)
class Ways:
    """Values of a loss, a launch that they change, and columns that show it."""

    values: tuple[float, ...]
    launch: dict[str, float]
    t_end: float
    columns: tuple[str, ...] = ()
    record: tuple[str, ...] = ()
    bad: tuple[str, ...] = ("-1", "much")
    bodies: dict[str, Any] = field(default_factory=dict)
    # Losses that come with it, so that few kernels serve all.
    beside: dict[str, float] = field(default_factory=dict)


STEADY = {"n_i": -0.1, "omega_xy0": 0.01}
UNSTEADY = {"n_i": 0.3, "omega_xy0": 0.1}
SLIDES = ("t_slide", "n_slides", "slide_time", "slide_work")
HOLDS = ("t_held", "held_time", "pivot_work")
# A loss without an entry here fails.
WAYS = {
    "sigma": Ways(
        (0.0, 0.05, 0.2),
        UNSTEADY,
        60,
        bodies={"c": 3},
        beside={"rolling": 1e-3},
    ),
    "rolling": Ways(
        (0.0, 1e-3, 0.01),
        UNSTEADY,
        60,
        bad=("2", "much"),
        bodies={"c": 3},
        beside={"sigma": 0.01},
    ),
    "mu": Ways(
        (0.2, 0.3, 1e3),
        UNSTEADY,
        60,
        SLIDES,
        ("contact", "energy", "reversals", "windows"),
        ("0", "-1", "much"),
    ),
    "pivot": Ways(
        (0.0005, 0.002, 0.006), STEADY, 900, HOLDS, bad=("-1", "2", "much", "16 um")
    ),
    "creep": Ways(
        (0.0, 0.3, 0.5),
        STEADY,
        200,
        ("creep_work", "creep_doubtful", "K_p_creep", "K_r_creep"),
        beside={"pivot": 0.002},
    ),
    "viscous": Ways((0.0, 30.0, 300.0), UNSTEADY, 60, ("slip_work", "n_p", "n_r")),
}
names = pytest.mark.parametrize("name", LOSSES)


def config_of(name, values, **keys):
    ways = WAYS[name]
    return {
        "bodies": {"source": "preset", "name": "GH"} | ways.bodies,
        "spin": ways.launch,
        "dissipation": ways.beside | {name: values},
        "horizon": {"t": ways.t_end},
        "record": list(ways.record),
    } | keys


def plan_of_table(name, values, **losses):
    """Plan a table of two rows with a column of a loss."""
    body = rs.Rattleback.gh()
    rows = {parameter: getattr(body, parameter) for parameter in PARAMETERS}
    rows |= {"n_i": [0.1, 0.2], "omega_xy0": 0.01}
    if values is not None:
        rows[name] = values
    losses = WAYS[name].beside | losses
    keys = {"bodies": {"source": "table", "path": "rows"}, "dissipation": losses}
    return make_plan(parse_config(keys), rows=frame_bodies(pd.DataFrame(rows)))


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=pytest.mark.slow) if name == "creep" else name
        for name in LOSSES
    ],
)
def test_every_way_gives_the_same_rows(name, tmp_path):
    """A sweep, arrays of values, rows of a table, and a sweep that has grown."""
    ways = WAYS[name]
    values = list(ways.values)
    settings = {"record": list(ways.record)}
    sweep = rs.sweep(config_of(name, values), output=tmp_path / "out")
    runs = sweep.read()
    assert (runs.status == "ok").all()
    assert sweep.summary[name].tolist() == values
    columns = ["n_end", "n_steps", "energy_drift", "type", "energy_left", *ways.columns]
    assert runs.energy_left.nunique() == 3
    body = dataclasses.replace(rs.Rattleback.gh(), **ways.bodies)
    losses = ways.beside | {name: values}
    at_once = rs.simulate(
        body, **ways.launch, **losses, t_end=ways.t_end, threads=1, **settings
    )
    for column in columns:
        assert at_once[column].equals(runs[column]), column

    table = runs[[*PARAMETERS, *ways.bodies, *ways.launch, name, *ways.beside]]
    settings["horizon"] = {"t": ways.t_end}
    rows = rs.sweep(table, output=tmp_path / "table", threads=1, **settings).read()
    assert rows[columns].equals(runs[columns])

    for part in ([values[1]], [values[1], values[0], values[2]]):
        grown = rs.sweep(config_of(name, part), output=tmp_path / "grown").read()
    grown = grown.sort_values(name, ignore_index=True)
    assert grown[columns].equals(runs[columns])


@names
def test_its_default_is_as_if_it_was_left_out(name):
    default = LOSSES[name].default
    plain = parse_config(config_of(name, None, dissipation={}))
    same = parse_config(config_of(name, None, dissipation={name: default}))
    assert physics_hash(same) == physics_hash(plain)
    assert make_plan(same).schema.equals(make_plan(plain).schema)
    launch = {"n_i": 0.1, "omega_xy0": 0.01}
    without = rs.simulate("GH", **launch).to_dict()
    assert rs.simulate("GH", **launch, **{name: default}).to_dict() == without


@names
def test_bad_values_are_refused_by_options_and_keys(name):
    launch = ["--preset", "GH", "--n-i", "0.3", "--omega-xy0", "0.1", "--t-end", "60"]
    for value in WAYS[name].bad:
        done = CliRunner().invoke(main, ["trajectory", *launch, f"--{name}", value])
        assert done.exit_code == 2, done.output
        assert name in done.output
    for value in (*WAYS[name].bad, [None, 0.1], [0.1, 0.1], "table"):
        with pytest.raises(rs.ConfigError, match="dissipation"):
            parse_config(config_of(name, value))


@names
def test_a_table_may_have_it(name):
    """What all rows share is the only case."""
    _, low, high = WAYS[name].values
    plan = plan_of_table(name, [low, high])
    assert plan.config.dissipation.values[name] == ["table"]
    assert plan.source.bodies(float("nan"), plan.targets[:0].astype(int)).losses
    shared = plan_of_table(name, low)
    assert [case.value(name) for case in shared.cases] == [low]


@names
def test_a_bad_table_is_refused(name):
    _, low, high = WAYS[name].values
    with pytest.raises(rs.ConfigError, match=f"row 2: {name} is empty"):
        plan_of_table(name, [low, None])
    with pytest.raises(rs.ConfigError, match=f"dissipation.{name}: there are several"):
        plan_of_table(name, [low, high], **{name: [low, high]})
    missing = f"dissipation.{name}: the table has no column {name}; give a number"
    with pytest.raises(rs.ConfigError, match=missing):
        plan_of_table(name, None, **{name: "table"})
