"""One run as an animated page: the rolling body, its trace and its spin.

The page is made from `page/`: `scene.js` (the drawing), `player.js` (time and controls)
and `three.min.js`, which `bundle.sh` makes. It contains all it needs and forbids
network access.
"""

import base64
import hashlib
import html
import json
import math
import re
from importlib.metadata import version
from importlib.resources import files
from typing import Any

import numpy as np

from rattlesweep.analysis.onerun.course import Course, PreparedRun
from rattlesweep.analysis.onerun.solids import solid_of_page
from rattlesweep.arrays import Floats, Integers
from rattlesweep.system.console import shortened
from rattlesweep.words.defaults import FRAMES_A_PERIOD
from rattlesweep.words.errors import ConfigError
from rattlesweep.words.quantities import DRIVES, LOSSES, RATE, TIME

_COLUMNS = ("q0", "q1", "q2", "q3", "trace_x", "trace_y", "n", "E_p", "E_r", "energy")
_CHANNELS = ("t", *_COLUMNS, "contact_z")
# The fewest rows in a period of the pitch, for long runs.  The page interpolates by
# cubics; with the default number the body slips by at most 5e-5 of the contact's speed
# (GH, n = 0.1 and -0.1).
_LEAST = 10
# A row takes 54 bytes of the page, which stays below 5 MB.
FEWEST_ROWS = 201
MOST_FRAMES = 80_000
THEORY_POINTS = 800
_MARGIN = (
    1.25  # the body is drawn up to above all contact points and its centre of mass
)
DRAWN_HEIGHT = 0.99  # fraction of the height of an ellipsoid's lower half that is drawn
TRAIL = 6  # periods of the roll that the trace of the contact shows
# Seconds until the first reversal at the page's initial speed, and bounds of this
# speed.
SECONDS_TO_REVERSAL = 30
SLOWEST = 4.0
FASTEST = 25.0
_MOST_TIMES = 6  # that a fact lists
_SOURCES = ("page.css", "three.min.js", "scene.js", "player.js")


def course_of_page(
    run: PreparedRun, points: int | None, from_time: float | None = None
) -> Course:
    """Return a run with the channels of its page, and the rows it needs or `points`."""
    if run.model != "full":
        raise ConfigError(
            f"the model {run.model} has no moving body; show needs the full one"
        )
    if points is None:
        points = run.even_rows(FRAMES_A_PERIOD, FEWEST_ROWS, MOST_FRAMES, from_time)
        if run.even_rows(_LEAST, 2, MOST_FRAMES + 1, from_time) > MOST_FRAMES:
            raise ConfigError(
                f"t_end {run.t_end:g} is too long for one page; shorten --t-end"
            )
    return Course(run, _CHANNELS, points=points, from_time=from_time)


def make_scene(course: Course) -> dict[str, Any]:
    """Integrate a course of :func:`course_of_page`; return what its page shows."""
    columns = course.columns()
    # A failed run is shown as far as its numbers are finite.
    good = np.logical_and.reduce([np.isfinite(columns[name]) for name in _CHANNELS])
    rows = len(good)
    if not good.all():
        rows = int(np.argmin(good))
    ended = course.follower
    if rows < 2:
        raise ConfigError(f"the run ends at t = {ended.t:g}: {ended.status.meaning}")
    columns = {name: columns[name][:rows] for name in _CHANNELS}
    t = columns["t"]
    launches = course.run.launches
    body = course.run.body
    start = float(t[0])
    end = float(t[-1])
    rise = max(1.0, _MARGIN * float(np.max(1 - columns["contact_z"])))
    # An ellipsoid ends at its rim, c above the bottom.
    rise = min(rise, DRAWN_HEIGHT * body.get("c", math.inf))
    first_zero = course.reversals[0] if course.reversals else end
    speed = (max(first_zero, start) - start) / SECONDS_TO_REVERSAL
    units = {"t": (1.0, "√(a/g)"), "n": (1.0, "√(g/a)")}
    for name in units:
        if name in course.si:
            units[name] = (course.si[name].size, course.si[name].unit)
    facts = _facts(course, units["t"])
    solid = None
    if course.run.pose is not None:
        solid, told = solid_of_page(course.run.pose)
        facts.insert(0, ("mesh", told))
    return {
        "columns": columns,
        "theory": launches.gh.spin(np.linspace(start, end, THEORY_POINTS)),
        "body": body,
        "solid": solid,
        "start": start,
        "step": (end - start) / (rows - 1),
        "rise": rise,
        "energy": float(columns["energy"][0]),
        "lossy": bool(course.run.losses),
        "slides": [slide for slide in course.slides if slide[1] >= start],
        "reversals": [time for time in course.reversals if time >= start],
        "trail": TRAIL * 2 * math.pi / float(launches.modes.omega_r[0]),
        "speed": min(FASTEST, max(SLOWEST, speed)),
        "units": units,
        "facts": facts,
    }


def _facts(course: Course, time: tuple[float, str]) -> list[tuple[str, str]]:
    """Return the facts that the page lists; `time` is its unit's size and name."""
    run = course.run
    launches = run.launches
    ended = course.follower
    modes = launches.modes
    t_rgh = float(launches.gh.t_rgh[0])
    frequencies = [run.with_unit(x[0], RATE) for x in (modes.omega_p, modes.omega_r)]
    facts: dict[str, str] = {}
    if run.units is not None:
        facts["size"] = (
            f"M = {run.units.mass:.4g} kg, a = {1000 * run.units.length:.4g} mm, "
            f"√(a/g) = {run.units.time:.4g} s"
        )
    facts["dissipation"] = run.acting(LOSSES)
    facts["the plane shakes"] = run.acting(DRIVES)
    facts["launched along"] = f"{math.degrees(run.launch['psi']):.4g}°"
    facts["K_p, K_r"] = f"{modes.K_p[0]:.4g}, {modes.K_r[0]:.4g}"
    facts["ω_p, ω_r"] = ", ".join(frequencies)
    facts["t_rGH"] = "none"
    if math.isfinite(t_rgh):
        facts["t_rGH"] = run.with_unit(t_rgh, TIME)
    facts["turns"] = _listed(course.reversals, ended.t, *time)
    if ended.zeros != course.reversals:
        facts["zeros"] = _listed(ended.zeros, ended.t, *time)
    facts["slides"] = course.slides_in_words
    facts["integrated by"] = ", ".join(map(str, run.integrator.values()))
    facts["status"] = ended.status.label
    facts["beware"] = course.warning
    # Exponents keep their hyphen, so that they can be copied into programs.
    return [
        (name, re.sub(r"(?<!e)-", "−", text)) for name, text in facts.items() if text
    ]


def _listed(times: list[float], end: float, size: float, unit: str) -> str:
    """Return the first times in a unit, or that there are none by the end."""
    if not times:
        return f"none by {size * end:g} {unit}"
    return f"{shortened([f'{size * time:.8g}' for time in times], _MOST_TIMES)} {unit}"


def make_page(scene: dict[str, Any], title: str, subtitle: str) -> bytes:
    """Return the page of a scene, with title and subtitle escaped for HTML."""
    table = np.stack([scene["columns"][name] for name in _COLUMNS], axis=1)
    arrays: dict[str, Any] = {
        "columns": _COLUMNS,
        "table": _encode(table),
        "theory": _encode(scene["theory"]),
    }
    if scene["solid"] is not None:
        arrays["solid"] = {
            "vertices": _encode(scene["solid"]["vertices"]),
            "faces": _encode(scene["solid"]["faces"], "<u2"),
        }
    data = json.dumps(scene | arrays, ensure_ascii=False, allow_nan=False)
    folder = files("rattlesweep.analysis.onerun") / "page"
    page = (folder / "page.html").read_text(encoding="utf-8")
    sources = {name: (folder / name).read_text(encoding="utf-8") for name in _SOURCES}
    inserts = {
        "policy": _policy(sources),
        "version": html.escape(version("rattlesweep")),
        "title": html.escape(title),
        "subtitle": html.escape(subtitle),
        # The text of the data cannot close its element.
        "data": data.replace("<", "\\u003c"),
        **sources,
    }
    # One pass, so that inserted text is not searched for placeholders.
    return re.sub(r"@@([\w.]+)@@", lambda match: inserts[match[1]], page).encode()


def _policy(sources: dict[str, str]) -> str:
    """Return a policy that forbids all origins, and all code but the page's own."""
    scripts = []
    style = ""
    for name, text in sources.items():
        digest = base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()
        if name.endswith(".css"):
            style = f"'sha256-{digest}'"
        else:
            scripts.append(f"'sha256-{digest}'")
    return (
        f"default-src 'none'; script-src {' '.join(scripts)}; style-src {style}; "
        "img-src data:; base-uri 'none'; form-action 'none'"
    )


def _encode(values: Floats | Integers, kind: str = "<f4") -> str:
    return base64.b64encode(values.astype(kind).tobytes()).decode()
