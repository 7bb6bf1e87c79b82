"""Tables as they come: columns that are only copied, folders of files, contradictions,
taps.
"""

from __future__ import annotations

import datetime
import decimal
import warnings
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from sweeping import HEAD, ROW

import rattlesweep as rs
from rattlesweep.design.bodies import table
from rattlesweep.words.errors import ConfigError, ConfigWarning

BODY = dict(zip(HEAD.split(","), map(float, ROW.split(",")), strict=True))
SPIN = {"n_i": 0.1, "omega_xy0": 0.01}
SI = {
    "mass_kg": 0.085,
    "height_m": 0.01,
    "ixx_kg_m2": 6e-6,
    "iyy_kg_m2": 9e-5,
    "izz_kg_m2": 9.2e-5,
    "ixy_kg_m2": -2e-6,
    "r1_m": 0.5,
    "r2_m": 0.015,
    "axes_angle_deg": 2.0,
}


def runs_of(path: Any, output: Any, **keys: Any) -> pd.DataFrame:
    config = {"bodies": {"source": "table", "path": str(path)}, "model": "gh"}
    with warnings.catch_warnings(action="ignore", category=ConfigWarning):
        return rs.sweep(config | {"spin": SPIN} | keys, output=output).runs


def stored(values: pd.Series) -> list[Any]:
    return [None if value is pd.NA or value != value else value for value in values]


@pytest.mark.parametrize(
    ("cells", "expected"),
    [
        (["20240101123456789", "20240101123456788", ""], None),
        (["1234e567", "7654e321"], None),
        (["inf", "1.5", "nan"], None),
        (["NA", "null", ""], None),
        (["007", "010"], None),
        (["1E5", "1.10"], None),
        (["-0", "+5"], None),
        (["true", "False"], None),
        (["9223372036854775808", "1"], None),
        ([" a", "grün"], None),
        (["7", "-12", ""], [7, -12, None]),
        (["9007199254740993", "5"], [2**53 + 1, 5]),
        (["0.1", "3", "1e-07", ""], [0.1, 3, 1e-7, None]),
    ],
)
@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "latin-1", "utf-16"])
def test_cells_of_csv_that_are_copied_stay_as_they_are(
    cells, expected, encoding, tmp_path
):
    lines = [f"{HEAD},id", *(f"{ROW},{cell}" for cell in cells)]
    (tmp_path / "t.csv").write_text("\n".join(lines), encoding=encoding)
    held = table.read_bodies(str(tmp_path / "t.csv")).carried["id"]
    if expected is None:
        expected = [cell or None for cell in cells]
    found = stored(pd.Series(held, dtype=object))
    assert [value if value is None else str(value) for value in found] == [
        value if value is None else str(type(found[k])(value))
        for k, value in enumerate(expected)
    ]


def test_a_copied_decimal_comma_is_a_number_and_a_text_keeps_it(tmp_path):
    lines = [f"{HEAD},id,note", f"{ROW},1.5,2.50", f"{ROW},2,x"]
    text = "\n".join(lines).replace(",", ";").replace(".", ",")
    (tmp_path / "t.csv").write_text(text)
    held = table.read_bodies(str(tmp_path / "t.csv")).carried
    assert held["id"].tolist() == [1.5, 2.0]
    assert held["note"].tolist() == ["2,50", "x"]


@pytest.mark.parametrize(
    ("column", "expected"),
    [
        (pa.array([2**63 + 1, 2**63 + 3], pa.uint64()), None),
        (pa.array([2**60 + 1, None], pa.int64()), None),
        (pa.array([2**63 + 1, None], pa.uint64()), None),
        (pa.array(["x", "y"]).dictionary_encode(), None),
        (pa.array([float("inf"), 0.5]), ["inf", "0.5"]),
        (pa.array([b"gr\xfcn", "grün".encode()]), ["grün", "grün"]),
        (pa.array([decimal.Decimal("1.10"), None]), ["1.10", None]),
        (pa.array([datetime.date(2024, 1, 2), None]), ["2024-01-02", None]),
    ],
)
def test_columns_of_any_type_are_stored_as_they_are(column, expected, tmp_path):
    if expected is None:
        expected = column.to_pylist()
    frame = pa.table(
        {name: [value] * 2 for name, value in BODY.items()} | {"id": column}
    )
    pq.write_table(frame, tmp_path / "t.parquet")
    with warnings.catch_warnings(action="ignore", category=ConfigWarning):
        in_memory = rs.sweep(frame, spin=SPIN, model="gh", output=tmp_path / "m")
    from_file = runs_of(tmp_path / "t.parquet", tmp_path / "f")
    for runs in (in_memory.runs, from_file):
        assert stored(runs["id"]) == expected
    # The table in the directory gives the same sweep again.
    assert in_memory.verify(recompute=2).problems == []


def test_a_number_of_more_than_64_bits_is_refused_by_name():
    frame = pd.DataFrame([BODY])
    frame["id"] = pd.Series([2**70], dtype=object)
    with pytest.raises(
        ConfigError,
        match="id has a whole number of more than 64 bits; give it as texts",
    ):
        rs.simulate(frame, **SPIN)


def write(folder: Any, name: str, kind: Any = None, **more: Any) -> None:
    folder.mkdir(exist_ok=True)
    columns = {key: pa.array([value], kind) for key, value in BODY.items()}
    for key, value in more.items():
        columns[key] = pa.array([value])
    pq.write_table(pa.table(columns), folder / f"{name}.parquet")


def test_a_folder_has_the_columns_of_all_files_in_their_widest_type(tmp_path):
    folder = tmp_path / "d"
    write(folder, "a", pa.float32(), short=1)
    write(folder, "b", c=5.0, t_end=33.0, stone=7.5, psi=0.2)
    bodies = {"source": "table", "path": str(folder), "surface": "ellipsoid", "c": 3.0}
    runs = runs_of(folder, tmp_path / "o", bodies=bodies)
    assert runs.alpha.tolist() == [np.float32(13.04), 13.04]
    assert runs.c.tolist() == [3.0, 5.0]
    assert runs.t_end[0] > 100
    assert runs.t_end[1] == 33.0
    assert runs.psi[1] == 0.2
    assert stored(runs.stone) == [None, 7.5]
    assert stored(runs.short) == [1, None]


@pytest.mark.parametrize(
    ("first", "second", "words"),
    [
        (
            {},
            {"n_i": 0.5, "omega_xy0": 0.1},
            "a.parquet has no column n_i, which b.parq",
        ),
        ({"mu": 0.3}, {}, "b.parquet has no column mu, which a.parquet has"),
        ({"id": "x"}, {"id": 3}, "id is string in a.parquet and int64 in b.parquet"),
        (
            {"id": 2**60 + 1},
            {"id": 0.5},
            "id is int64 in a.parquet and double in b.par",
        ),
    ],
)
def test_a_folder_whose_files_do_not_fit_is_refused(first, second, words, tmp_path):
    write(tmp_path / "d", "a", **first)
    write(tmp_path / "d", "b", **second)
    with pytest.raises(ConfigError, match=words):
        runs_of(tmp_path / "d", tmp_path / "o")


def test_names_of_folders_are_columns_and_an_empty_folder_is_refused(tmp_path):
    write(tmp_path / "d", "kept")
    for k in (1, 2):
        write(tmp_path / "d" / f"k={k}", "a")
    (tmp_path / "d" / "kept.parquet").unlink()
    assert runs_of(tmp_path / "d", tmp_path / "o").k.tolist() == [1, 2]
    (tmp_path / "e").mkdir()
    with pytest.raises(ConfigError, match="the folder has no Parquet file"):
        runs_of(tmp_path / "e", tmp_path / "o2")


@pytest.mark.parametrize(
    ("columns", "words"),
    [
        (
            {"xi_deg": -5.0},
            "row 1: xi by the tensor and the radii is 0.0111150, and by",
        ),
        ({"minus_xi_deg": 5.0}, "and by minus_xi_deg -0.0872665; keep one of them"),
        ({"xi": -0.1}, "row 1: xi is -0.1, and by the tensor and the radii 0.011115"),
        ({"theta": 0.5}, "theta is 0.5, and by the tensor and the radii 0.666667"),
        ({"phi": 0.01}, "phi is 0.01, and by the tensor"),
        ({"alpha": 3.0}, "alpha is 3, and by the tensor"),
        ({"beta": 2.0}, "beta is 2, and by the tensor"),
        ({"gamma": 9.0}, "gamma is 9, and by the tensor"),
        ({"f_sd": 0.1}, "f_sd is 0.1, and by the tensor"),
        ({"n_i_rpm": 60.0}, "n_i is 0.1, and by n_i_rpm 0.200607; keep one"),
        ({"t_end": 60.0, "t_end_s": 3.0}, "t_end is 60, and by t_end_s 93.9628"),
    ],
)
def test_columns_that_contradict_each_other_are_refused(columns, words):
    words = words.replace("0.0111150", "0.011115")
    with pytest.raises(ConfigError, match=words):
        rs.simulate(pd.DataFrame([SI | SPIN | columns]), model="gh")


def test_columns_that_agree_are_taken():
    (run,) = rs.simulate(pd.DataFrame([SI | SPIN]), model="gh").to_dict("records")
    same = {"theta": run["theta"], "xi_deg": np.degrees(run["xi"]), "t_end_s": np.nan}
    (again,) = rs.simulate(pd.DataFrame([SI | SPIN | same]), model="gh").t_r
    assert again == run["t_r"]
    both = BODY | SPIN | {"xi_deg": -3.0, "minus_xi_deg": 4.0}
    del both["xi"]
    with pytest.raises(ConfigError, match=r"xi by minus_xi_deg is -0\.06981"):
        rs.simulate(pd.DataFrame([both]), model="gh")


def test_a_full_state_and_a_spin_that_contradict_each_other_are_refused():
    state = {"omega_x": 0.01, "omega_y": 0.0, "omega_z": -0.1}
    state |= {"u_x": 0.0, "u_y": 0.0, "u_z": -1.0, "t_end": 1.0}
    runs = rs.simulate(pd.DataFrame([BODY | state]))
    assert rs.simulate(runs).n_i.tolist() == runs.n_i.tolist() == [0.1]
    with pytest.raises(ConfigError, match=r"n_i is 0\.3, and by omega and u 0\.1"):
        rs.simulate(runs.assign(n_i=0.3))


def test_taps_of_a_table_end_at_the_horizons_of_its_rows(tmp_path):
    rows = pd.DataFrame([BODY | {"t_end": 2.0}, BODY | {"t_end": 3.0}])
    tap = {"n_i": 0, "omega_xy0": 0.1}
    sweep = rs.sweep(rows, spin=tap, model="reduced", output=tmp_path / "o")
    assert sweep.runs.t_end.tolist() == [2.0, 3.0]
    assert rs.simulate(rows, model="reduced", **tap).t_end.tolist() == [2.0, 3.0]
    rows.loc[1, "t_end"] = np.nan
    with pytest.raises(
        ConfigError, match=r"horizon\.t: missing; a launch without spin .*has no t_rGH"
    ):
        rs.sweep(rows, spin=tap, model="reduced", output=tmp_path / "o2")


def test_a_spin_that_is_a_rounding_error_of_zero_is_asked_about(tmp_path):
    spins = [-0.9, -1.1e-16, 0.9]
    words = "n_i: -1.1e-16 is a rounding error beside 0.9; is 0 meant, a tap"
    with pytest.warns(ConfigWarning, match=f"^{words}"):
        rs.simulate("GH", n_i=spins, omega_xy0=0.01, model="gh")
    config = {"bodies": {"source": "preset", "name": "GH"}, "model": "gh"}
    config["spin"] = {"n_i": spins, "omega_xy0": 0.01}
    with pytest.warns(ConfigWarning, match=f"^spin.{words}"):
        rs.sweep(config, output=tmp_path / "o")
    rows = pd.DataFrame([BODY | SPIN | {"n_i": spin} for spin in spins])
    with pytest.warns(ConfigWarning, match=f"bodies.path: {words[5:]}"):
        rs.sweep(rows, model="gh", output=tmp_path / "p")


def test_a_sweep_grows_by_the_numbers_of_a_range(tmp_path):
    config = {"bodies": {"source": "preset", "name": "GH"}, "model": "gh"}
    for spins in ([-0.1, -0.3], {"linspace": [-0.1, -0.5, 5]}):
        config["spin"] = {"n_i": spins, "omega_xy0": 0.01}
        sweep = rs.sweep(config, output=tmp_path / "o")
    assert len(sweep.read(where="n_i == -0.3")) == 1
    config["spin"] = {"n_i": [-0.30000000000000004], "omega_xy0": 0.01}
    with pytest.raises(ConfigError, match=r"runs with n_i -0\.1"):
        rs.sweep(config, output=tmp_path / "o")
