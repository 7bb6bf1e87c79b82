"""`contact_patch` and `rattlesweep contact`: reference stones, remarks, refusals."""

import json

import numpy as np
import pytest
from refusal import assert_refused
from sweeping import ROOT, invoke

import rattlesweep as rs

LARGE = rs.Rattleback.half_ellipsoid(
    length="12 cm", width="3 cm", height="12 mm", mass="60 g", skew="3 deg"
)
SMALL = rs.Rattleback.half_ellipsoid(
    length="9.5 cm", width="1.9 cm", height="11 mm", mass="13.2931 g", skew="3 deg"
)
OPTIONS = ("--half-ellipsoid", "12cm,3cm,12mm", "--mass", "60g", "--skew", "3deg")


@pytest.mark.parametrize(
    ("body", "materials", "mean_radius", "seconds"),
    [
        (LARGE, ("PLA", "glass"), 180, "9.1"),
        (LARGE, ("PLA", "wood"), 295, "5.5"),
        (LARGE, ("wood", "wood"), 342, "4.8"),
        (LARGE, ("steel", "glass"), 73, "22.3"),
        (SMALL, ("PLA", "glass"), 98, "10.2"),
        (SMALL, ("wood", "wood"), 187, "5.4"),
    ],
)
def test_reference_stones(body, materials, mean_radius, seconds):
    """In um and s at 60 rpm and mu = 0.3, computed by another program."""
    patch = rs.contact_patch(body, materials)
    assert round(1e6 * patch.mean_radius) == mean_radius
    assert f"{patch.t_spin:.1f}" == seconds
    # From dn/dt = -pivot/gamma.
    units = body.units
    slowed = 2 * np.pi * units.time * body.gamma / patch.pivot * units.time
    assert patch.t_spin == pytest.approx(slowed, rel=1e-14)
    assert patch.lever == pytest.approx(patch.pivot * units.length, rel=1e-15)


def test_creep_goes_with_the_lever():
    """It takes ``c lever / mu^2``, so more the lower the friction is."""
    modes = rs.modes(LARGE)
    for mu in (0.2, 0.3):
        patch = rs.contact_patch(LARGE, ("PLA", "glass"), mu=mu)
        assert patch.creep == mu
        strength = 128 / (9 * np.pi**2) * patch.pivot / mu**2
        inertia = LARGE.alpha * np.cos(modes.psi_r) ** 2
        inertia += LARGE.beta * np.sin(modes.psi_r) ** 2
        taken = strength * modes.omega_r**2 / inertia
        assert modes.K_r - patch.K_r_creep == pytest.approx(taken, rel=1e-12)
    slight = rs.Rattleback.half_ellipsoid(
        length="12 cm", width="3 cm", height="12 mm", mass="60 g", skew="0.3 deg"
    )
    remarks = rs.contact_patch(slight, ("PLA", "wood"), mu=0.2).remarks
    assert any("no steady spin turns back" in remark for remark in remarks)


@pytest.mark.slow
def test_a_lever_is_an_argument_of_a_run():
    lever = rs.contact_patch(LARGE, ("PLA", "glass")).pivot
    launch = {"n_i": "60 rpm", "omega_xy0": "6 rpm", "t_end": "1 s"}
    run = rs.simulate(LARGE, **launch, pivot=lever)
    assert run.pivot == lever


def test_materials_in_all_forms():
    pla = {"E": "3.5 GPa", "nu": 0.36}
    patch = rs.contact_patch(LARGE, ("pla", "Glass"), mu=0.5)
    assert rs.contact_patch(LARGE, (pla, "glass"), mu=0.5).lever == patch.lever
    assert rs.contact_patch(LARGE, patch.materials, mu=0.5).lever == patch.lever
    assert rs.contact_patch(LARGE, ("glass", "PLA")).lever < patch.lever
    file = {"shape": "half_ellipsoid", "length": "12 +- 0.1 cm", "width": "3 cm"}
    file |= {"height": "12 mm", "mass": "60 g", "skew": "3 deg"}
    assert rs.contact_patch(file, ("PLA", "glass"), mu=0.5).lever == patch.lever


@pytest.mark.parametrize(
    ("facet", "words"),
    [("0.1 mm", ", larger than"), ("0.4 mm", "not wider"), ("1 mm", "not larger")],
)
def test_a_facet(facet, words):
    remarks = rs.contact_patch(LARGE, ("PLA", "glass"), facet=facet).remarks
    assert words in remarks[1]
    assert facet in remarks[1]


def test_a_patch_that_is_not_small():
    gel = {"E": "50 kPa", "nu": 0.5}
    remarks = rs.contact_patch(LARGE, (gel, "glass")).remarks
    assert "not small" in remarks[1]


@pytest.mark.parametrize(
    ("body", "materials", "settings", "words"),
    [
        ("GH", ("PLA", "glass"), {}, "needs a size and a mass"),
        (LARGE, ("PLA", "gold"), {}, "PLA, ABS, resin, acrylic, wood, glass, steel, "),
        (LARGE, "PLA", {}, "two are needed"),
        (LARGE, ("PLA",), {}, "two are needed"),
        (LARGE, ({"E": "3 GPa"}, "glass"), {}, "nu is missing"),
        (LARGE, ({"E": "3 GPa", "nu": 0.6}, "glass"), {}, "nu is 0.6"),
        (LARGE, ({"E": 3.5, "nu": 0.3}, "glass"), {}, "E is 3.5; from 1000"),
        (LARGE, ({"E": "3 mm", "nu": 0.3}, "glass"), {}, "a modulus is needed"),
        (LARGE, ({"G": 1, "nu": 0.3}, "glass"), {}, "is not one of E, nu"),
        (LARGE, ("PLA", "glass"), {"mu": 0}, "mu"),
        (LARGE, ("PLA", "glass"), {"mu": None}, "mu"),
        (LARGE, ("PLA", "glass"), {"n_i": "1 m"}, "n_i"),
        (LARGE, ("PLA", "glass"), {"facet": "1 s"}, "facet"),
    ],
)
def test_refusals(body, materials, settings, words):
    with pytest.raises(rs.ConfigError) as refusal:
        rs.contact_patch(body, materials, **settings)
    assert words in str(refusal.value)
    assert len(refusal.value.messages) == 1


def test_the_command():
    patch = rs.contact_patch(LARGE, ("PLA", "glass"), facet="0.4 mm")
    done = invoke(
        *("contact", *OPTIONS, "--materials", "PLA,E=70GPa nu=0.22"),
        *("--facet", "0.4mm", "--json"),
    )
    data = json.loads(done.stdout)
    assert data["lever"] == pytest.approx(patch.pivot, rel=1e-14)
    assert data["si"]["t_spin"]["value"] == pytest.approx(patch.t_spin, rel=1e-14)
    assert data["si"]["peak_pressure"]["unit"] == "Pa"
    assert tuple(data["remarks"]) == patch.remarks
    assert "0.4 mm" in done.stderr
    stone = ROOT / "configs/fit/stone.yaml"
    file = invoke("contact", stone, "--materials", "PLA,glass")
    options = invoke("contact", *OPTIONS, "--materials", "PLA,glass")
    assert file.stdout == options.stdout != ""
    assert "granite" in invoke("contact", "--materials", "list").stdout


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ((*OPTIONS, "--materials", "PLA,gold"), "--materials: "),
        ((*OPTIONS, "--materials", "PLA"), "--materials: "),
        (
            (*OPTIONS, "--materials", "PLA,glass", "--n-i", "60"),
            "--n-i: 60 has no unit",
        ),
        ((*OPTIONS, "--materials", "PLA,glass", "--mu", "-1"), "mu -1"),
        ((*OPTIONS, "--materials", "E=3 nu=0.3,glass"), "has no unit"),
        (("--preset", "GH", "--materials", "PLA,glass"), "needs a size and a mass"),
        (("s.yaml", "--mass", "1g", "--materials", "PLA,wood"), "--mass: STONE has"),
    ],
)
def test_refusals_of_the_command(options, words):
    assert_refused(invoke("contact", *options), 2, words)
