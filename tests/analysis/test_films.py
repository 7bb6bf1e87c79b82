"""Rows that are far off, and figures of several films, in short films."""

from __future__ import annotations

import numpy as np
import pytest
from sweeping import ROOT, invoke

import rattlesweep as rs
from rattlesweep.analysis.fit.synthetic import synthetic_film
from rattlesweep.api.single import launch_of

STONE = ROOT / "configs/fit/stone.yaml"
BODY = rs.Rattleback.half_ellipsoid(
    length="12 cm", width="3 cm", height="12 mm", mass="60 g", skew="3 deg"
)
PUSH = "10 rpm"
LAUNCHES = ("100 rpm", "-70 rpm")


def film_of(n_i, seed):
    run = launch_of(BODY, n_i=n_i, omega_xy0=PUSH, sigma="5e-7 N m s")
    return synthetic_film(run, "0.7 s", 60, "0.5 deg", seed)


@pytest.fixture(scope="module")
def films(tmp_path_factory):
    """Two short films of one stone, and a stone file with a known launch."""
    folder = tmp_path_factory.mktemp("films")
    paths = []
    for seed, n_i in enumerate(LAUNCHES):
        paths.append(folder / f"{seed}.csv")
        film_of(n_i, seed).to_csv(paths[-1], index=False)
    text = STONE.read_text().replace("n_i: 100 rpm", f"omega_xy0: {PUSH}")
    stone = folder / "stone.yaml"
    stone.write_text(text.replace("[n_i, omega_xy0, sigma]", "[n_i, sigma]"))
    return stone, paths


def test_a_row_that_is_far_off_is_named_and_left_out(films):
    stone, [path, _] = films
    table = film_of(LAUNCHES[0], 0)
    table.loc[20, "angle_deg"] += 500
    wrong = path.with_name("wrong.csv")
    table.to_csv(wrong, index=False)
    table.loc[20, "angle_deg"] = np.nan
    empty = path.with_name("empty.csv")
    table.to_csv(empty, index=False)
    plain = invoke("fit", stone, wrong)
    assert "warning: row 21 is off by" in plain.stderr
    assert "leave the rows out (--robust)" in plain.stderr
    robust = invoke("fit", stone, wrong, "--robust")
    assert "row 21 is off by" in robust.stderr
    assert "and left out" in robust.stderr
    expected = invoke("fit", stone, empty)
    assert robust.exit_code == expected.exit_code == 0
    found, alone = (
        [word for line in done.stdout.splitlines()[1:3] for word in line.split()[1:4]]
        for done in (robust, expected)
    )
    assert [*map(float, found)] == pytest.approx([*map(float, alone)], rel=1e-4)


def test_several_films_have_a_figure_and_no_profile(films, tmp_path):
    stone, paths = films
    picture = tmp_path / "films.png"
    result = invoke("fit", stone, *paths, "--figure", picture)
    assert result.exit_code == 0, result.stderr
    assert picture.stat().st_size > 20_000
    assert result.stdout.count("n_i_") == 2
    refused = invoke("fit", stone, *paths, "--profile", "sigma")
    assert refused.exit_code == 2
    assert "--profile takes one film; leave it out" in refused.stderr
    planned = invoke("fit", stone, "--plan", "1 s", "--figure", picture)
    assert planned.exit_code == 2
    assert "--figure shows films" in planned.stderr
