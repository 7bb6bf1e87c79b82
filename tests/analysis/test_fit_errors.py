"""Errors of the data and of measured sizes enter the intervals; profiles are exact."""

from __future__ import annotations

import json
import math

import numpy as np
import pandas as pd
import pytest
from refusal import assert_refused
from scipy.optimize import curve_fit, minimize_scalar
from sweeping import ROOT, invoke

import rattlesweep as rs
from rattlesweep.analysis.fit.doubts import doubts_of_errors

SIZES = {
    "length": "12 cm",
    "width": "3 cm",
    "height": "12 mm",
    "mass": "60 g",
    "skew": "0.05 rad",
}
STONE = {"shape": "half_ellipsoid", **SIZES}
LAUNCH = {"n_i": "100 rpm", "omega_xy0": "10 rpm"}
TIMES = np.linspace(0, 1.5, 80)
NOISE = 1.0  # rpm
FREE = ["n_i", "sigma"]


def spins(
    n_i: float, sigma: float, omega_xy0: float = 10, **sizes: float
) -> np.ndarray:
    """Return spins in rpm, for rates in rpm, sigma in 1e-7 N m s and SI sizes."""
    changed = {
        name: f"{value:.17g} {'kg' if name == 'mass' else 'm'}"
        for name, value in sizes.items()
    }
    body = rs.Rattleback.half_ellipsoid(**{**SIZES, **changed})
    run = rs.trajectory(
        body,
        n_i=f"{n_i:.17g} rpm",
        omega_xy0=f"{omega_xy0:.17g} rpm",
        sigma=f"{sigma * 1e-7:.17g} N m s",
        t_end="1.5 s",
        times=[f"{time!r} s" for time in TIMES.tolist()],
    )
    return run.table["n_rpm"].to_numpy()


def noisy(**sizes: float) -> pd.DataFrame:
    """Return noisy spins of a stone."""
    noise = np.random.default_rng(6).normal(0, NOISE, len(TIMES))
    return pd.DataFrame({"t_s": TIMES, "n_rpm": spins(100, 5, **sizes) + noise})


def in_people_units(fit: rs.Fit) -> tuple[np.ndarray, np.ndarray]:
    """Return values and standard errors in rpm, 1e-7 N m s, mm and g."""
    sizes = np.array([fit.unit_of(name)[0] for name in fit.values])
    sizes[list(fit.values).index("sigma")] *= 1e7
    values = sizes * np.array([*fit.values.values()])
    return values, sizes * np.sqrt(np.diag(fit.covariance))


def test_values_and_covariance_are_those_of_scipy():
    """The reference has the height as a parameter and its prior as one more datum."""
    data = noisy(height=0.01205)
    measured = {**STONE, "height": "12 +- 0.1 mm"}
    fit = rs.fit(measured, data, free=FREE, launch=LAUNCH, error=NOISE)

    def model(_: object, n_i: float, sigma: float, height: float) -> np.ndarray:
        return np.append(spins(n_i, sigma, height=height * 1e-3), height)

    y = np.append(data.n_rpm, 12.0)
    errors = np.append(np.full(len(TIMES), NOISE), 0.1)
    best, covariance = curve_fit(
        model, 0, y, [100, 5, 12], errors, True, method="trf", jac="3-point"
    )
    values, standard_errors = in_people_units(fit)
    expected_errors = np.sqrt(np.diag(covariance))
    assert list(fit.values) == ["n_i", "sigma", "height"]
    assert np.abs(values - best).max() < 0.01 * expected_errors.min()
    assert standard_errors == pytest.approx(expected_errors, rel=2e-3)
    expected = covariance / np.outer(expected_errors, expected_errors)
    assert fit.correlations.to_numpy() == pytest.approx(expected, abs=2e-3)
    residuals = (y - model(0, *best)) / errors
    assert fit.chi_squared == pytest.approx((residuals**2).sum(), rel=1e-6)
    assert fit.dof == len(TIMES) + 1 - 3
    assert fit.reduced_chi_squared == fit.chi_squared / fit.dof
    # The fitted body and launch are those that the values describe.
    again = rs.trajectory(fit.body, **fit.launch, t_end="1.5 s", points=2)
    last = spins(best[0], best[1], height=best[2] * 1e-3)[-1]
    assert again.table["n_rpm"].iloc[-1] == pytest.approx(last, abs=0.02)


@pytest.mark.parametrize("error", [NOISE, None])
def test_a_quantity_that_only_the_scale_tells_keeps_its_error(error):
    """Of the motion, the mass changes nothing but the meaning of sigma in N m s."""
    data = noisy()
    exact = rs.fit(STONE, data, free=FREE, launch=LAUNCH, error=error)
    stone = {**STONE, "mass": "60 ± 3 g"}
    fit = rs.fit(stone, data, free=FREE, launch=LAUNCH, error=error)
    half_width = 1.959964 * 3
    assert fit.in_si["mass"] == (
        pytest.approx(60, rel=1e-5),
        pytest.approx(60 - half_width, rel=1e-4),
        pytest.approx(60 + half_width, rel=1e-4),
        "g",
    )
    _, errors = in_people_units(fit)
    values, of_exact = in_people_units(exact)
    assert errors[0] == pytest.approx(of_exact[0], rel=1e-3)
    assert errors[1] == pytest.approx(math.hypot(of_exact[1], values[1] / 20), rel=1e-3)
    assert fit.noise == pytest.approx(exact.noise, rel=1e-3)
    assert fit.dof == exact.dof


def test_exact_data_move_a_wrong_ruler_to_the_truth():
    data = pd.DataFrame({"t_s": TIMES, "n_rpm": spins(100, 5, height=0.01215)})
    stone = {**STONE, "height": "12 +- 0.1 mm"}
    fit = rs.fit(stone, data, free=FREE, launch=LAUNCH, error="0.001 rpm")
    assert in_people_units(fit)[0] == pytest.approx([100, 5, 12.15], rel=1e-5)
    unknown = rs.fit(stone, data, free=FREE, launch=LAUNCH)
    assert in_people_units(unknown)[0] == pytest.approx([100, 5, 12.15], rel=1e-3)


def test_a_prior_of_the_launch_is_one_of_the_parameters_of_the_fit():
    data = noisy()
    launch = {**LAUNCH, "n_i": "101 +- 0.2 rpm"}
    fit = rs.fit(STONE, data, free="sigma", launch=launch, error=NOISE)
    free = rs.fit(STONE, data, free=FREE, launch=LAUNCH, error=NOISE)
    assert list(fit.values) == ["sigma", "n_i"]
    value, error = (numbers[0] for numbers in in_people_units(fit))
    (n_i, sigma), (n_i_error, sigma_error) = in_people_units(free)
    # The mean of two measurements of one quantity, and what it says of the other.
    weights = np.array([0.2, n_i_error]) ** -2.0
    mean = np.average([101, n_i], weights=weights)
    slope = free.correlations.loc["n_i", "sigma"] * sigma_error / n_i_error
    assert fit.in_si["n_i"][0] == pytest.approx(mean, abs=0.01)
    assert value == pytest.approx(sigma + slope * (mean - n_i), abs=0.05 * error)


def test_a_parameter_of_a_body_without_size_has_a_prior():
    body = {"preset": "GH", "theta": "0.64 +- 0.01", "xi_deg": "-1.7 +- 0.1"}
    launch = {"n_i": -0.2, "omega_xy0": 0.02}
    run = rs.trajectory("GH", **launch, sigma=3e-3, t_end=30, points=100)
    data = run.table[["t", "n"]]
    fit = rs.fit(body, data, free="sigma", launch=launch, error=1e-4)
    assert list(fit.values) == ["sigma", "theta", "xi"]
    truth = {"sigma": 3e-3, "theta": 0.6429, "xi": math.radians(-1.72)}
    for name, value in truth.items():
        low, high = fit.intervals[name]
        assert low < value < high
        assert high - low < 0.3 * abs(value)


def test_rows_count_by_their_own_errors():
    data = noisy()
    one_error = rs.fit(STONE, data, free=FREE, launch=LAUNCH, error="1 rpm")
    columns = data.assign(n_error_rad_s=math.pi / 30)
    same = rs.fit(STONE, columns, free=FREE, launch=LAUNCH)
    assert same.values == pytest.approx(one_error.values, rel=1e-7)
    assert same.chi_squared == pytest.approx(one_error.chi_squared)
    columns.loc[:20, "n_rpm"] += 30
    columns.loc[:20, "n_error_rad_s"] = 1e4
    late = rs.fit(STONE, columns, free=FREE, launch=LAUNCH)
    assert late.dof == one_error.dof
    assert late.chi_squared < one_error.chi_squared
    ratios = np.diag(late.covariance) / np.diag(one_error.covariance)
    assert (ratios > 1.1).all()
    low, high = late.intervals["n_i"]
    assert low - (high - low) < one_error.values["n_i"] < high + (high - low)


@pytest.mark.slow
def test_errors_that_the_residuals_contradict_are_told():
    data = noisy()
    small = rs.fit(STONE, data, free=FREE, launch=LAUNCH, error=NOISE / 3)
    assert "per degree of freedom is" in small.remarks[-1]
    assert small.remarks[-1].endswith(
        "too small, or the model does not describe the data"
    )
    (too_large,) = doubts_of_errors(40.0, 100)
    assert too_large.endswith("is 0.4: the errors are too large")
    assert doubts_of_errors(120.0, 100) == []
    launch = {**LAUNCH, "n_i": "95 +- 0.5 rpm"}
    wrong = rs.fit(STONE, data, free="sigma", launch=launch)
    assert any("standard errors from the measured" in text for text in wrong.remarks)
    unknown = rs.fit(STONE, data, free=FREE, launch=LAUNCH)
    assert unknown.remarks == []
    assert unknown.chi_squared is unknown.reduced_chi_squared is None
    assert unknown.noise == pytest.approx(NOISE, rel=0.2)


@pytest.mark.slow
def test_a_profile_is_that_of_fits_at_fixed_values(tmp_path):
    """With much noise, chi squared is no parabola along sigma, which may be zero."""
    exact = spins(100, 5)
    data = noisy()
    data["n_rpm"] = exact + 15 * (data.n_rpm - exact)
    names = ["sigma", "omega_xy0"]
    fit = rs.fit(STONE, data, free=names, launch=LAUNCH, sigma="5e-7 N m s", error=15)
    profile = fit.profile("sigma")
    assert list(profile) == ["sigma", "delta_chi_squared", "omega_xy0"]
    assert profile.sigma.is_monotonic_increasing
    threshold = profile.attrs["threshold"]
    assert threshold == pytest.approx(1.959964**2, rel=1e-6)
    ends = profile.attrs["interval"]
    assert ends[0] == profile.sigma.iloc[0] == 0
    increases = (profile.delta_chi_squared.iloc[0], threshold)
    assert increases[0] < threshold
    for value, increase in zip(ends, increases, strict=True):
        sigma = value * fit.unit_of("sigma")[0] * 1e7

        def chi_squared(omega_xy0: float, sigma: float = sigma) -> float:
            residuals = (data.n_rpm - spins(100, sigma, omega_xy0)) / 15
            return float((residuals**2).sum())

        best = float(np.interp(value, profile.sigma, profile.omega_xy0))
        best *= fit.unit_of("omega_xy0")[0]
        least = minimize_scalar(chi_squared, bounds=(0.97 * best, 1.03 * best))
        assert least.fun - fit.chi_squared == pytest.approx(increase, rel=1e-3)
    # The parabola is wrong, and sigma cannot be negative: the fit takes the profile.
    assert fit.intervals["sigma"] == pytest.approx(ends)
    half_width = 1.96 * fit.covariance.loc["sigma", "sigma"] ** 0.5
    assert half_width > fit.values["sigma"]
    assert abs(ends[1] - fit.values["sigma"] - half_width) > 0.05 * ends[1]

    figure = fit.plot_profile(profile, tmp_path / "profile.png")
    (legend,) = figure.legends
    labels = [text.get_text() for text in legend.get_texts()]
    assert labels == ["profile", "covariance", "95 %"]
    assert legend.get_title().get_text().startswith("95 %: 0 to 1.3")
    assert (tmp_path / "profile.png").stat().st_size > 10_000
    with pytest.raises(rs.ConfigError, match='profile: "mu" is not one of sigma, om'):
        fit.profile("mu")


def stone_file(body: str = "mass: 60 g", more: str = "") -> str:
    sizes = "shape: half_ellipsoid, length: 12 cm, width: 3 cm, height: 12 mm"
    return (
        f"body: {{{sizes}, skew: 0.05 rad, {body}}}\n"
        f"launch: {{n_i: 100 rpm, omega_xy0: 10 rpm}}\nfree: [n_i, sigma]\n{more}\n"
    )


def test_the_command_takes_errors_and_draws_a_profile(tmp_path):
    (tmp_path / "stone.yaml").write_text(stone_file("mass: 60 +- 1 g", "error: 9 deg"))
    noisy().to_csv(tmp_path / "spins.csv", index=False)
    files = ("fit", tmp_path / "stone.yaml", tmp_path / "spins.csv")
    picture = tmp_path / "profile.png"
    options = ("--error", "1 rpm", "--profile", "sigma", "--figure", picture)
    result = invoke(*files, *options)
    assert result.exit_code == 0, result.stderr
    assert picture.stat().st_size > 10_000
    lines = result.stdout.splitlines()
    assert [line.split()[0] for line in lines[1:4]] == ["n_i", "sigma", "mass"]
    assert lines[4].startswith("correlations: n_i sigma 0.")
    assert lines[5].startswith("profile of sigma: 95 % from ")
    assert lines[5].endswith(" N m s")
    assert ", chi squared " in result.stderr.splitlines()[-1]
    printed = json.loads(invoke(*files, "-q", *options[:4], "--json").stdout)
    assert printed["chi_squared"] / printed["dof"] == printed["reduced_chi_squared"]
    assert printed["correlations"]["mass"]["mass"] == pytest.approx(1)
    assert printed["covariance"]["mass"]["mass"] == pytest.approx(1e-6)
    assert len(printed["profile"]["sigma"]) > 10
    low, high = printed["profile"]["interval"]
    assert low < printed["values"]["sigma"] < high


@pytest.mark.parametrize(
    ("stone", "words"),
    [
        (stone_file("mass: 60 +- g"), ":1: body: mass: '60 +- g' is not a value with"),
        (stone_file("mass: 60 +- 0 g"), "has the error 0; a standard error is above"),
        (stone_file("mass: 60 +- 1"), "mass: 60 has no unit"),
        (stone_file("mass: 60 g +- 1 cm"), "'1.0 cm' is a length; a mass is needed"),
        (stone_file("mass: '60 +- 0,5 g'"), "decimal comma; write 0.5 g"),
        (stone_file("mass: 60 g, gravity: 9.8 +- 0.1 m/s^2"), "only length, width,"),
        (stone_file().replace("100 rpm", "100 +- 2 mm"), "is a length; a spin is need"),
        (stone_file().replace("[n_i", "[weights"), "weights is not among the keys"),
        (
            "body: {preset: KL}\nfree: [mass]",
            "free: mass is not among the keys of the body",
        ),
        (stone_file(more="error: 0.5"), "error: 0.5 has no unit; give a standard"),
        (
            stone_file(more="error: 0.5 deg"),
            "0.5 deg is no standard error of n_rpm; give",
        ),
        (stone_file(more="error: -1 rpm"), "error: -1 rpm is not above zero; give a"),
    ],
)
def test_bad_errors_are_one_sentence(tmp_path, stone, words):
    (tmp_path / "stone.yaml").write_text(stone)
    (tmp_path / "data.csv").write_text("t_s,n_rpm\n0,100\n1,90\n2,80\n3,70\n")
    result = invoke("fit", tmp_path / "stone.yaml", tmp_path / "data.csv")
    assert_refused(result, 2, "stone.yaml:", words)


@pytest.mark.parametrize(
    ("data", "option", "words"),
    [
        ("n_error_rpm\n1\n0\n1\n1", [], "data.csv: row 2: n_error_rpm is 0; give a"),
        ("n_error_rpm\n1\n1\n1\n", [], "row 4: n_error_rpm has no finite value"),
        (
            "n_error\n1\n1\n1\n1",
            [],
            "n_error does not end in a unit; name the column n_",
        ),
        ("n_error_rpm\n1\n1\n1\n1", ["--error", "1 rpm"], "keep one"),
        (
            "x\n1\n1\n1\n1",
            ["--error", "1 mm"],
            "--error: 1 mm is no standard error of n",
        ),
    ],
)
def test_bad_errors_of_data_are_one_sentence(tmp_path, data, option, words):
    (tmp_path / "stone.yaml").write_text(stone_file())
    rows = ["t_s,n_rpm", "0,100", "1,90", "2,80", "3,70"]
    lines = [f"{row},{cell}" for row, cell in zip(rows, data.split("\n"), strict=True)]
    (tmp_path / "data.csv").write_text("\n".join(lines) + "\n")
    files = (tmp_path / "stone.yaml", tmp_path / "data.csv")
    assert_refused(invoke("fit", *files, *option), 2, words)


def test_the_films_of_the_page_are_told_of_by_one_stone_file(tmp_path):
    text = (ROOT / "configs/fit/stone.yaml").read_text()
    assert "height: 12 mm" in text
    (tmp_path / "stone.yaml").write_text(text.replace("12 mm", "12 +- 0.05 mm"))
    data = ROOT / "configs/fit/data.csv"
    printed = json.loads(
        invoke("fit", tmp_path / "stone.yaml", data, "--json", "-q").stdout
    )
    assert printed["chi_squared"] is None
    low, high = printed["intervals"]["sigma"]
    # Far wider than with an exact ruler: 2.6e-4.
    assert 3e-4 < high - low < 1.2e-3
    assert low < 4e-3 < high
