"""The key `dissipation.mu`: cases, columns, tables, and what it excludes."""

from dataclasses import replace

import pandas as pd
import pytest

import rattlesweep as rs
from rattlesweep.config.read import parse_config, physics_hash
from rattlesweep.design.bodies.table import frame_bodies
from rattlesweep.design.plan import make_plan
from rattlesweep.words.quantities import LOSSES

BASE = {
    "bodies": {"source": "preset", "name": "GH"},
    "spin": {"n_i": -0.3, "omega_xy0": 0.02},
}
COLUMNS = ["mu", "t_slide", "n_slides", "slide_time", "slide_work"]
ROWS = pd.DataFrame(
    {
        "alpha": 13.04,
        "beta": 1.522,
        "gamma": 12.28,
        "theta": 0.6429,
        "phi": 0.036,
        "xi": -0.03,
        "n_i": [0.1, 0.2],
        "omega_xy0": 0.01,
        "mu": [0.1, 0.2],
    }
)


def config_of(losses=None, **keys):
    return parse_config(BASE | keys | {"dissipation": losses or {}})


def test_without_it_nothing_changes():
    plain = config_of()
    assert physics_hash(config_of({"mu": None})) == physics_hash(plain)
    assert not {"mu", *COLUMNS} & {*make_plan(plain).schema.names}
    viscous = make_plan(config_of({"sigma": 0.1}))
    assert not {*COLUMNS} & {*viscous.schema.names}
    assert [case.dump() for case in viscous.cases] == [
        {"case": 0, "n_i": -0.3, "omega_xy0": 0.02, "sigma": 0.1, "rolling": 0.0}
    ]


def test_several_values_are_cases_beside_those_of_other_losses():
    config = config_of({"mu": [0.1, 0.3], "sigma": [0, 0.01], "rolling": 0.001})
    plan = make_plan(config)
    values = [tuple(map(case.value, ("sigma", "rolling", "mu"))) for case in plan.cases]
    assert values == [
        (0, 0.001, 0.1),
        (0, 0.001, 0.3),
        (0.01, 0.001, 0.1),
        (0.01, 0.001, 0.3),
    ]
    assert plan.schema.names[-5:] == COLUMNS
    assert {"energy_left", "growth"} <= {*plan.schema.names}
    # A sweep may grow by further values, but those without sliding are another sweep.
    assert physics_hash(config) == physics_hash(
        config_of({"mu": 0.5, "rolling": 0.001})
    )
    assert physics_hash(config) != physics_hash(config_of({"rolling": 0.001}))


def test_a_table_without_friction_is_refused():
    """A coefficient of zero is no limit of rolling."""
    config = parse_config({"bodies": {"source": "table", "path": "rows"}})
    with pytest.raises(rs.ConfigError, match="row 1: mu is 0; it must be positive"):
        make_plan(config, rows=frame_bodies(ROWS.assign(mu=[0, 0.1])))


def test_rules_on_what_acts_wait_for_the_columns_of_a_table():
    bodies = {"source": "table", "path": "rows"}
    creeping = parse_config({"bodies": bodies, "dissipation": {"creep": 0.3}})
    plan = make_plan(creeping, rows=frame_bodies(ROWS.assign(pivot=0.002)))
    assert {"creep", "pivot"} <= {*plan.schema.names}
    with pytest.raises(rs.ConfigError, match=r"dissipation\.creep: the contact creeps"):
        make_plan(creeping, rows=frame_bodies(ROWS))
    decaying = parse_config({"bodies": bodies, "horizon": {"t_decay": 2.0}})
    make_plan(decaying, rows=frame_bodies(ROWS.assign(sigma=[0.0, 0.1])))
    with pytest.raises(rs.ConfigError, match=r"horizon\.t_decay: .* and sigma is 0"):
        make_plan(decaying, rows=frame_bodies(ROWS.assign(sigma=0.0)))


@pytest.mark.parametrize(
    ("mu", "message"),
    [
        (0, "a value above 0 is needed"),
        (-1, "a value above 0 is needed"),
        (1e9, "a value below 1e[+]06 is needed"),
        ("0.3 m", "is not a number; give one, without a unit"),
        ("none", "is not a number"),
        ([None, 0.1], "a number is needed"),
        ([0.1, 0.1], "a value is repeated"),
        ("table", "the word table needs source: table; give a number"),
    ],
)
def test_a_bad_value_is_refused(mu, message):
    with pytest.raises(rs.ConfigError, match=f"dissipation.*{message}"):
        config_of({"mu": mu})


def test_a_law_without_an_average_is_refused_in_the_reduced_model(monkeypatch):
    config_of({"rolling": 1e-3}, model="reduced")
    # A new law has none, as long as nobody has written it.
    law = replace(LOSSES["rolling"], is_averaged=False)
    monkeypatch.setitem(LOSSES, "rolling", law)
    with pytest.raises(rs.ConfigError, match="no average of rolling over swings"):
        config_of({"rolling": 1e-3}, model="reduced")
    config_of({"rolling": 1e-3})


@pytest.mark.parametrize(
    ("keys", "place"),
    [
        ({"model": "reduced"}, "dissipation.mu"),
        ({"model": "gh"}, "dissipation"),
        ({"record": ["volume"]}, "record"),
        ({"record": ["lyapunov"]}, "record"),
        ({"integrator": {"method": "rk4"}}, "integrator.method"),
        ({"classify": {"early": True}}, "classify"),
    ],
)
def test_what_sliding_excludes_is_refused(keys, place):
    with pytest.raises(rs.ConfigError) as refused:
        config_of({"mu": 0.3}, **keys)
    assert [message.split(":")[0] for message in refused.value.messages] == [place]
