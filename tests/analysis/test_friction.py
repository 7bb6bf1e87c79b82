"""Commands about one run warn where rolling needs a friction that a table may lack."""

from __future__ import annotations

import re

import pytest
from sweeping import invoke, run

import rattlesweep as rs

FAST = ("--preset", "GH", "--n-i", "0.2", "--omega-xy0", "0.01", "--t-end", "100")
SLOW = ("--preset", "GH", "--n-i", "0.05", "--omega-xy0", "0.01", "--t-end", "60")
NEEDED = re.compile(r"warning: .* coefficient of friction of (?:about )?([\d.]+)[,;]")


@pytest.fixture(scope="module")
def needed() -> float:
    """The largest ratio of the forces at the contact in the fast run."""
    channels = ["F_tangential", "F_normal"]
    forces = rs.trajectory(
        "GH", n_i=0.2, omega_xy0=0.01, t_end=100, points=20_001, channels=channels
    ).table
    ratio = forces["F_tangential"] / forces["F_normal"]
    assert 0.3 < ratio.max() < 1
    return float(ratio.max())


def warned(stderr: str) -> float:
    match = NEEDED.search(stderr)
    assert match is not None, stderr
    return float(match[1])


def test_a_trajectory_says_how_much_friction_it_needs(needed, tmp_path):
    result = invoke("trajectory", *FAST, "--output", tmp_path / "fast.csv")
    assert warned(result.stderr) == pytest.approx(needed, rel=0.03)
    result = invoke("trajectory", *SLOW, "--output", tmp_path / "slow.csv")
    assert "friction" not in result.stderr


def test_a_page_and_a_replay_say_it_too(needed, tmp_path):
    page = tmp_path / "fast.html"
    result = invoke("show", *FAST, "--output", page)
    assert warned(result.stderr) == pytest.approx(needed, rel=0.03)
    assert "coefficient of friction of" in page.read_text()
    sets = ("spin.n_i=[0.2]", "spin.omega_xy0=[0.01]")
    assert run("gh.yaml", tmp_path / "out", *sets).exit_code == 0
    chosen = ("--case", 0, "--sample", 0, "--t-end", 100)
    result = invoke("replay", tmp_path / "out", *chosen, "--output", tmp_path / "r.csv")
    assert warned(result.stderr) == pytest.approx(needed, rel=0.03)


def test_a_body_says_about_how_much_its_reversal_needs(needed):
    body = ("--preset", "GH", "--omega-xy0", "0.01")
    result = invoke("body", *body, "--n-i", "0.2")
    assert warned(result.stderr) == pytest.approx(needed, rel=0.03)
    assert "warning" not in invoke("body", *body, "--n-i", "0.05").stderr
