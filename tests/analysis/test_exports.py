"""Files of programs are read as they are; what they leave open is asked."""

from __future__ import annotations

import io
import itertools
import math
import sys
import zipfile

import numpy as np
import pytest
from natural import natural

import rattlesweep as rs
from rattlesweep.analysis.fit.film import read_film

BODY = rs.Rattleback.half_ellipsoid(
    length="12 cm", width="3 cm", height="12 mm", mass="60 g", skew="3 deg"
)
T = np.arange(40) / 120
ANGLE = 0.3 + 9 * T - T**2
X = 50 * np.cos(ANGLE)
Y = 50 * np.sin(ANGLE)
FOLDED = np.angle(np.exp(1j * ANGLE))
TRACKER = "mass A\nt\tx\ty\tθ_{r}\n"
PHYPHOX = '"Time (s)","Gyroscope x (rad/s)","Gyroscope y (rad/s)",'
PHYPHOX += '"Gyroscope z (rad/s)","Absolute (rad/s)"\n'


def lines(*columns, separator="\t", comma=False, end=""):
    """Return rows of numbers as Java writes them."""
    text = ""
    for row in zip(*columns, strict=True):
        line = separator.join("" if math.isnan(x) else f"{x:.9E}" for x in row) + end
        text += (line.replace(".", ",") if comma else line) + "\n"
    return text


def seen(tmp_path, text, n_i=None, encoding="utf-8"):
    path = tmp_path / "export.txt"
    path.write_text(text, encoding)
    return read_film(path, BODY.units, n_i=n_i)


@pytest.mark.parametrize(
    ("head", "columns", "style"),
    [
        (TRACKER, (T, X, Y, np.degrees(FOLDED)), {}),
        (TRACKER, (T, X, Y, np.degrees(FOLDED)), {"comma": True}),
        (TRACKER, (T, X, Y, FOLDED), {}),
        (
            ";mass A;;;;\nt;x;y;θr;\n",
            (T, X, Y, np.degrees(FOLDED)),
            {"separator": ";", "comma": True, "end": ";"},
        ),
        ("#multi:\n\tA\t\tB\t\t\nt\tx\ty\tx\ty\t\n", (T, -X, -Y, X, Y), {"end": "\t"}),
        ("t_s,x1_px,y1_px,x2_px,y2_px\n", (T, -X, Y, X, -Y), {"separator": ","}),
        ("t_s,x1,y1,x2,y2\n", (T, -X, -Y, X, Y), {"separator": ","}),
    ],
    ids=["tabs", "commas", "radians", "semicolons", "two-masses", "pixels", "marks"],
)
def test_an_angle_is_read_from_marks(tmp_path, head, columns, style):
    film = seen(tmp_path, head + lines(*columns, **style), n_i=0.2)
    assert film.kind == "angle"
    assert film.t * BODY.units.time == pytest.approx(T, abs=1e-8)
    # An axis has no front.
    turned = film.value - ANGLE
    assert turned == pytest.approx(turned[0], abs=1e-6)
    assert math.remainder(turned[0], math.pi) == pytest.approx(0, abs=1e-6)


def test_a_gap_of_marks_is_a_gap_of_the_angle(tmp_path):
    columns = [column.copy() for column in (T, X, Y, np.degrees(FOLDED))]
    for column in columns[1:]:
        column[5:8] = np.nan
    film = seen(tmp_path, TRACKER + lines(*columns))
    assert np.flatnonzero(~film.known).tolist() == [5, 6, 7]


@pytest.mark.parametrize("separator", [",", "\t", ";"])
def test_a_phone_tells_the_rate_about_its_own_axis(tmp_path, separator):
    rate = 9 - 2 * T
    head = PHYPHOX.replace(",", separator)
    rows = lines(T + 2, 0.1 * rate, 0 * T, rate, rate, separator=separator)
    film = seen(tmp_path, head + rows)
    assert film.kind == "gyro"
    assert film.value / BODY.units.time == pytest.approx(rate)
    assert film.t[0] == 0


@pytest.mark.slow
def test_the_rate_of_a_phone_is_fitted_with_the_tilt_of_the_stone():
    """On a tilted stone the rate about its own axis is not the spin."""
    truth = {"n_i": 0.3, "omega_xy0": 0.1, "sigma": 4e-3}
    run = rs.trajectory(
        BODY, **natural(**truth, t_end=60), points=300, channels=["t", "n", "omega_z"]
    ).table
    size = 1 / BODY.units.time
    data = {
        "Time (s)": run.t_s,
        "Gyroscope z (rad/s)": -size * run.omega_z.to_numpy(),
    }
    launch = natural(n_i=0.31, omega_xy0=0.1)
    fit = rs.fit(BODY, data, free=["n_i", "sigma"], launch=launch)
    for name in ("n_i", "sigma"):
        assert fit.values[name] == pytest.approx(truth[name], rel=1e-5)


@pytest.mark.parametrize(
    ("text", "question"),
    [
        ("mass A\nt\tx\ty\n" + lines(T, X, Y), "x and y of one mark are no angle"),
        (
            "mass A\nt\tθ_{r}\n" + lines(T, 20 + T),
            "in degrees or in radians",
        ),
        (
            "t_s,x1,y1,x2,y2\n" + lines(T, -X, -Y, X, Y, separator=","),
            "does y1 count up or down",
        ),
        (PHYPHOX + lines(T, 9 + T, T, T, 9 + T, separator=","), "lay the phone flat"),
        ("A\nt\tθ_{r}\tθ_{r}\n" + lines(T, X, Y), "it has 2 angles"),
        ("A\nt\tx\ty\tx\ty\tx\ty\n" + lines(T, X, Y, X, Y, X, Y), "of two marks"),
    ],
)
def test_what_an_export_leaves_open_is_asked_for(tmp_path, text, question):
    if "degrees or" in question:
        text = text.replace("E+01", "E-01")
    with pytest.raises(rs.ConfigError, match=question):
        seen(tmp_path, text)


def layout(marks, separator, comma, trailing):
    """Return a table as Tracker exports it.

    Since version 6.1 there may be a separator after the last name and the last head,
    and none after the rows.
    """
    end = separator if trailing else ""
    if marks == 2:
        heads = ["t", "x", "y", "x", "y"]
        title = f"#multi:\n{separator}A{separator}{separator}B{separator}{end}\n"
        columns = (T, -X, -Y, X, Y)
    else:
        heads = ["t", "x", "y", "θ_{r}"]
        title = f"mass_A{end}\n"
        columns = (T, X, Y, np.degrees(FOLDED))
    head = separator.join(heads) + end + "\n"
    return title + head + lines(*columns, separator=separator, comma=comma)


@pytest.mark.parametrize("marks", [1, 2])
@pytest.mark.parametrize("trailing", [False, True], ids=["5", "6.1"])
@pytest.mark.parametrize(
    ("separator", "comma"),
    list(itertools.product(["\t", ";", ",", " "], [False, True])),
)
def test_all_layouts_of_tracker_are_read(tmp_path, marks, trailing, separator, comma):
    film = seen(tmp_path, layout(marks, separator, comma, trailing))
    assert film.kind == "angle"
    assert film.t * BODY.units.time == pytest.approx(T, abs=1e-8)
    turned = film.value - ANGLE
    assert turned == pytest.approx(turned[0], abs=1e-6)


RATE = 9 - 2 * T
SMALL = 0.1 * RATE
START = 1_764_300_000_000_000_000  # ns since 1970


def phone(head, *columns, separator=",", comma=False, end=""):
    """Return a table with a line of names and numbers of many digits."""
    rows = ""
    for row in zip(*columns, strict=True):
        cells = [str(x) if isinstance(x, int | str) else f"{x:.9f}" for x in row]
        line = separator.join(cells) + end
        rows += (line.replace(".", ",") if comma else line) + "\n"
    return f"{head}\n{rows}"


NANOSECONDS = [START + round(1e9 * t) for t in T.tolist()]
DATES = [f"2026-11-28 12:00:{t:06.3f}" for t in T.tolist()]
ZERO = 0 * T
XYZ = (SMALL, ZERO, RATE)
DEGREES = tuple(np.degrees(axis) for axis in XYZ)
SEMICOLONS = {"separator": ";", "comma": True}
# Heads of exports, as sources and repositories of their users show them.
PHONES = {
    "phyphox": (
        '"Time (s)","Gyroscope x (rad/s)","Gyroscope y (rad/s)",'
        '"Gyroscope z (rad/s)","Absolute (rad/s)"',
        (T, *XYZ, RATE),
        {},
    ),
    "phyphox, three axes": (
        '"Time (s)","Gyroscope x (rad/s)","Gyroscope y (rad/s)","Gyroscope z (rad/s)"',
        (T, *XYZ),
        {},
    ),
    "phyphox, tabs": (
        '"Time (s)"\t"Gyroscope x (rad/s)"\t"Gyroscope y (rad/s)"\t'
        '"Gyroscope z (rad/s)"',
        (T, *XYZ),
        {"separator": "\t"},
    ),
    "phyphox, semicolons": (
        '"Time (s)";"Gyroscope x (rad/s)";"Gyroscope y (rad/s)";"Gyroscope z (rad/s)"',
        (T, *XYZ),
        SEMICOLONS,
    ),
    "phyphox, German": (
        '"Zeit (s)";"Gyroskop x (rad/s)";"Gyroskop y (rad/s)";"Gyroskop z (rad/s)"',
        (T, *XYZ),
        SEMICOLONS,
    ),
    "phyphox, French": (
        '"Temps (s)","Gyroscope x (rad/s)","Gyroscope y (rad/s)","Gyroscope z (rad/s)"',
        (T, *XYZ),
        {},
    ),
    "phyphox, own experiment": (
        '"Time (s)","X (rad/s)","Y (rad/s)","Z (rad/s)"',
        (T, *XYZ),
        {},
    ),
    "phyphox, first version": (
        '"time","Gyroscope x","Gyroscope y","Gyroscope z","abs Gyroscope"',
        (T, *XYZ, RATE),
        {},
    ),
    "phyphox, all sensors": (
        '"Time (s)","Acceleration z (m/s^2)",'
        '"Gyroscope x (rad/s)","Gyroscope y (rad/s)","Gyroscope z (rad/s)"',
        (T, ZERO + 9.8, *XYZ),
        {},
    ),
    "phyphox, z alone": ('"Time (s)","Gyroscope z (rad/s)"', (T, RATE), {}),
    "Sensor Logger": ("time,seconds_elapsed,z,y,x", (NANOSECONDS, T, *XYZ[::-1]), {}),
    "Sensor Logger, x first": (
        "time,seconds_elapsed,x,y,z",
        (NANOSECONDS, T, *XYZ),
        {},
    ),
    "Sensor Logger, motion": (
        "time,seconds_elapsed,rotationRateX,rotationRateY,rotationRateZ,gravityX",
        (NANOSECONDS, T, *XYZ, ZERO),
        {},
    ),
    "Physics Toolbox": ("time,wx,wy,wz", (T, *XYZ), {}),
    "Physics Toolbox, comma last": ("\ntime,wx,wy,wz", (T, *XYZ), {"end": ","}),
    "Physics Toolbox, commas last": ("\n\ntime,wx,wy,wz,", (T, *XYZ), {"end": ","}),
    "Physics Toolbox, semicolons": ("time;wx;wy;wz", (T, *XYZ), SEMICOLONS),
    "Physics Toolbox, all sensors": (
        "time,gFx,gFy,gFz,wx,wy,wz,p,Bx,By,Bz,Azimuth,Pitch,Roll",
        (T, ZERO, ZERO, ZERO + 1, *XYZ, *[ZERO] * 7),
        {},
    ),
    "AndroSensor": (
        "ACCELEROMETER X (m/s²),GYROSCOPE X (rad/s),GYROSCOPE Y (rad/s),"
        "GYROSCOPE Z (rad/s),Time since start in ms ,YYYY-MO-DD HH-MI-SS_SSS",
        (ZERO, *XYZ, 1000 * T, DATES),
        {},
    ),
    "AndroSensor, semicolons": (
        "GYROSCOPE X (rad/s);GYROSCOPE Y (rad/s);"
        "GYROSCOPE Z (rad/s);Time since start in ms ;YYYY-MO-DD HH-MI-SS_SSS",
        (*XYZ, 1000 * T, DATES),
        SEMICOLONS,
    ),
    "SensorLog, gyroscope": (
        "loggingTime(txt),gyroTimestamp_sinceReboot(s),"
        "gyroRotationX(rad/s),gyroRotationY(rad/s),gyroRotationZ(rad/s)",
        (DATES, T + 50_000, *XYZ),
        {},
    ),
    "SensorLog, motion": (
        "loggingTime(txt),motionTimestamp_sinceReboot(s),"
        "motionRotationRateX(rad/s),motionRotationRateY(rad/s),"
        "motionRotationRateZ(rad/s)",
        (DATES, T + 50_000, *XYZ),
        {},
    ),
    "in degrees": (
        "Time (s),Gyroscope X (deg/s),Gyroscope Y (deg/s),Gyroscope Z (deg/s)",
        (T, *DEGREES),
        {},
    ),
    "with blanks": (
        "Time(sec), Gyroscope X(rad/S),Gyroscope Y(rad/S),Gyroscope Z(rad/S)",
        (T, *XYZ),
        {},
    ),
    "nanoseconds": (
        "timestamp,gyro_x_rad/s,gyro_y_rad/s,gyro_z_rad/s",
        (NANOSECONDS, *XYZ),
        {},
    ),
    "milliseconds": (
        "timestamp (ms),Angular velocity X(°/s),Angular velocity Y(°/s),"
        "Angular velocity Z(°/s)",
        (1000 * T + 7e5, *DEGREES),
        {},
    ),
}


@pytest.mark.parametrize("name", PHONES)
def test_gyroscopes_of_phones_are_read(tmp_path, name):
    head, columns, style = PHONES[name]
    film = seen(tmp_path, phone(head, *columns, **style))
    assert film.kind == "gyro"
    assert film.t * BODY.units.time == pytest.approx(T, abs=2e-6)
    assert film.value / BODY.units.time == pytest.approx(RATE, abs=1e-6)


@pytest.mark.parametrize(
    ("head", "columns", "question"),
    [
        ('"t","x","y","z"', (T, *XYZ), "are t, x, y, z the rates of a gyroscope"),
        ("Timestamp,X,Y,Z", (NANOSECONDS, *XYZ), "the rates of a gyroscope?"),
        ("time,gyro_x,gyro_y,gyro_z", (T, *XYZ), "in rad/s or in degrees a second"),
        ("time,wx,wy,wz", (T, *XYZ[::-1]), "lay the phone flat"),
        (
            "time,seconds_elapsed,z,y,x",
            (NANOSECONDS, T, ZERO + 9.8, SMALL, ZERO),
            "look like an acceleration",
        ),
        ("Gyroscope z (rad/s)", (RATE,), 'a gyroscope needs a column "Time \\(s\\)"'),
        (
            '"Time","A/0/X","A/0/Y","B/0/X","B/0/Y"',
            ([*range(len(T))], X, Y, -X, -Y),
            "does Time count frames or milliseconds",
        ),
    ],
)
def test_what_a_phone_leaves_open_is_asked_for(tmp_path, head, columns, question):
    with pytest.raises(rs.ConfigError, match=question):
        seen(tmp_path, phone(head, *columns))


@pytest.mark.parametrize("comma", [False, True])
@pytest.mark.parametrize("separator", [",", ";"])
@pytest.mark.parametrize("size", [1.0, 1000.0])
def test_two_marks_of_kinovea_are_an_angle(tmp_path, comma, separator, size):
    head = ["Time", "end 1/0/X", "end 1/0/Y", "end 2/0/X", "end 2/0/Y"]
    text = separator.join(f'"{name}"' for name in head) + "\r\n"
    for row in zip(size * T, -X, -Y, X, Y, strict=True):
        cells = [f"{number:.6f}" for number in row]
        if comma:
            cells = [cell.replace(".", ",") for cell in cells]
        text += separator.join(f'"{cell}"' for cell in cells) + "\r\n"
    film = seen(tmp_path, text)
    assert film.t * BODY.units.time == pytest.approx(T, abs=1e-6)
    turned = film.value - ANGLE
    assert turned == pytest.approx(turned[0], abs=1e-6)


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("", "is empty; export it again"),
        ("\n \n", "is empty; export it again"),
        ("mass_A\t\t\t\nt\tx\ty\t\n", "it has a header and no rows"),
        ("time,wx,wy,wz\n", "it has a header and no rows"),
        ("t_s,angle_deg,angle_deg\n0,1,2\n1,2,3\n", "it has 2 columns angle_deg"),
        ("t_s,t_s,angle_deg\n0,1,2\n1,2,3\n", "it has 2 columns t_s"),
        (
            "time,gyroscope x (rad/s),gyroscope x (rad/s)\n0,1,2\n1,2,3\n",
            "rates about one axis",
        ),
        ("0,1\n1,2\n", "line 1 is 0,1, and a header"),
        ("t_s,angle_deg\n0,1\n1\n", "its header has 2 columns and a row 1"),
        ("t_s,angle_deg\n0,1\n1,2,3\n", "its header has 2 columns and a row 3"),
        ("a,b\n0,1\n", "the columns are a, b; exports of AndroSensor, Kinovea"),
    ],
)
def test_a_table_that_is_none_is_refused_with_a_sentence(tmp_path, text, sentence):
    with pytest.raises(rs.ConfigError, match=sentence):
        seen(tmp_path, text)


def archive(**tables):
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w") as target:
        for name, text in tables.items():
            target.writestr(name.replace("__", "/") + ".csv", text)
    return content.getvalue()


def test_the_archive_of_a_phone_is_read(tmp_path):
    table = phone("time,wx,wy,wz", T, *XYZ)
    path = tmp_path / "phone.zip"
    for tables in (
        {"Raw Data": table, "meta__time": "event,experiment time\nSTART,0\n"},
        {"Gyroscope": table, "Accelerometer": "time,x\n0,1\n", "Metadata": "a\n1\n"},
    ):
        path.write_bytes(archive(**tables))
        film = read_film(path, BODY.units)
        assert film.value / BODY.units.time == pytest.approx(RATE)
    path.write_bytes(archive(one=table, two=table))
    with pytest.raises(rs.ConfigError, match=r"holds one\.csv, two\.csv; give the"):
        read_film(path, BODY.units)
    path.write_bytes(b"\xd0\xcf\x11\xe0" + bytes(600))
    with pytest.raises(rs.ConfigError, match=r"phone\.zip: "):
        read_film(path, BODY.units)


def workbook(names, rows):
    """Return a file of Excel with one sheet of numbers."""

    def cell(value):
        if isinstance(value, str):
            return f'<c t="inlineStr"><is><t>{value}</t></is></c>'
        return f"<c><v>{value}</v></c>"

    lines = "".join(f"<row>{''.join(map(cell, row))}</row>" for row in [names, *rows])
    main = "http://schemas.openxmlformats.org/spreadsheetml/2006/main"
    office = "http://schemas.openxmlformats.org/officeDocument/2006/relationships"
    package = "http://schemas.openxmlformats.org/package/2006"
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w") as target:
        target.writestr("[Content_Types].xml", f'<Types xmlns="{package}/types"/>')
        target.writestr(
            "_rels/.rels",
            f'<Relationships xmlns="{package}/relationships"><Relationship Id="r1" '
            f'Type="{office}/officeDocument" Target="xl/workbook.xml"/>'
            "</Relationships>",
        )
        target.writestr(
            "xl/workbook.xml",
            f'<workbook xmlns="{main}" xmlns:r="{office}"><sheets>'
            '<sheet name="Raw Data" sheetId="1" r:id="r1"/></sheets></workbook>',
        )
        target.writestr(
            "xl/_rels/workbook.xml.rels",
            f'<Relationships xmlns="{package}/relationships"><Relationship Id="r1" '
            f'Type="{office}/worksheet" Target="worksheets/sheet1.xml"/>'
            "</Relationships>",
        )
        target.writestr(
            "xl/worksheets/sheet1.xml",
            f'<worksheet xmlns="{main}"><sheetData>{lines}</sheetData></worksheet>',
        )
    return content.getvalue()


def test_a_file_of_excel_is_read_or_said_to_be_one(tmp_path, monkeypatch):
    path = tmp_path / "phyphox.xlsx"
    names = ["Time (s)", *(f"Gyroscope {axis} (rad/s)" for axis in "xyz")]
    path.write_bytes(workbook(names, np.stack([T, *XYZ], axis=1).tolist()))
    with monkeypatch.context() as patch:
        patch.setitem(sys.modules, "python_calamine", None)
        with pytest.raises(rs.ConfigError, match="is a file of Excel; export it as"):
            read_film(path, BODY.units)
    pytest.importorskip("python_calamine")
    film = read_film(path, BODY.units)
    assert film.value / BODY.units.time == pytest.approx(RATE)


@pytest.mark.parametrize(
    ("angle", "n_i", "size"),
    [
        # Folded, each unit is known by its jumps; beyond a turn, by the launch.
        (np.degrees(np.angle(np.exp(1j * (20 * T)))), None, 20),
        (np.angle(np.exp(1j * (20 * T + 2))), None, 20),
        (20 * T + 7, "200 rpm", 20),
        (np.degrees(20 * T) + 7, "200 rpm", 20),
        (20 * T + 7, None, None),
        (np.degrees(20 * T) + 400, None, None),
    ],
)
def test_the_unit_of_an_angle_beyond_a_turn_is_not_guessed(tmp_path, angle, n_i, size):
    text = "mass A\nt\tθ_{r}\n" + lines(T, angle)
    spin = None if n_i is None else 20 * BODY.units.time
    if size is None:
        with pytest.raises(rs.ConfigError, match="in degrees or in radians"):
            seen(tmp_path, text, n_i=spin)
        return
    film = seen(tmp_path, text, n_i=spin)
    assert film.first_spin / BODY.units.time == pytest.approx(size, rel=1e-6)
