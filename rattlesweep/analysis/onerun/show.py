"""One run as an animated page: the rolling body, its trace and its spin, in one HTML
file.

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
from rattlesweep.arrays import Floats
from rattlesweep.errors import ConfigError
from rattlesweep.sweeps.columns import RATE, TIME

COLUMNS = ("q0", "q1", "q2", "q3", "trace_x", "trace_y", "n", "E_p", "E_r")
CHANNELS = ("t", *COLUMNS, "contact_z", "energy")
# Rows in a period of the pitch, and the fewest for long runs.  The page interpolates by
# cubics, and the body slips by at most 5e-5 of the contact's speed (GH, n = 0.1 and
# -0.1).
PER_PERIOD, LEAST = 20, 10
FEWEST_ROWS, MOST_ROWS = (
    201,
    80_000,
)  # a row takes 48 bytes of the page, which stays below 5 MB
THEORY_POINTS = 800
MARGIN = 1.25  # the body is drawn up to above all contact points and its centre of mass
WIDEST = 0.99  # fraction of the height of an ellipsoid's lower half that is drawn
TRAIL = 6  # periods of the roll that the trace of the contact shows
# Seconds until the first reversal at the page's initial speed, and bounds of this
# speed.
SECONDS, SLOW, FAST = 30, 4.0, 25.0
SOURCES = ("page.css", "three.min.js", "scene.js", "player.js")


def course_of(
    run: PreparedRun, points: int | None, from_time: float | None = None
) -> Course:
    """Return a run with the channels and rows that its page needs, or with so many
    ``points``.
    """
    if run.model != "full":
        raise ConfigError(
            f"the model {run.model} has no moving body; show needs the full one"
        )
    if points is None:
        points = run.even_rows(PER_PERIOD, FEWEST_ROWS, MOST_ROWS, from_time)
        if run.even_rows(LEAST, 2, MOST_ROWS + 1, from_time) > MOST_ROWS:
            raise ConfigError(
                f"t_end {run.t_end:g} is too long for one page; shorten --t-end"
            )
    return Course(run, CHANNELS, points=points, from_time=from_time)


def make_scene(course: Course) -> dict[str, Any]:
    """Integrate a course of :func:`course_of`, and return the content of its page."""
    columns = course.columns()
    # A failed run is shown as far as its numbers are finite.
    good = np.logical_and.reduce([np.isfinite(columns[name]) for name in CHANNELS])
    rows = len(good) if good.all() else int(np.argmin(good))
    ended = course.follower
    if rows < 2:
        raise ConfigError(f"the run ends at t = {ended.t:g}: {ended.status.meaning}")
    columns = {name: columns[name][:rows] for name in CHANNELS}
    t, launches, body = columns["t"], course.run.launches, course.run.body
    start = float(t[0])
    rise = max(1.0, MARGIN * float(np.max(1 - columns["contact_z"])))
    first = [*ended.zeros, float(t[-1])][0]
    units = {"t": (1.0, "√(a/g)"), "n": (1.0, "√(g/a)")}
    units |= {
        name: (si.size, si.unit) for name, si in course.si.items() if name in units
    }
    return {
        "columns": columns,
        "theory": launches.gh.spin(np.linspace(start, t[-1], THEORY_POINTS)),
        "body": body,
        "start": start,
        "step": (float(t[-1]) - start) / (rows - 1),
        # An ellipsoid ends at its rim, c above the bottom.
        "rise": min(rise, WIDEST * body.get("c", np.inf)),
        "energy": float(columns["energy"][0]),
        "reversals": [time for time in course.reversals if time >= start],
        "trail": TRAIL * 2 * math.pi / float(launches.modes.omega_r[0]),
        "speed": min(FAST, max(SLOW, (max(first, start) - start) / SECONDS)),
        "units": units,
        "facts": _facts(course, units["t"]),
    }


def _facts(course: Course, time: tuple[float, str]) -> list[tuple[str, str]]:
    """Return the facts that the page lists, by name; `time` is the size and name of its
    unit.
    """
    run, launches, ended = course.run, course.run.launches, course.follower
    m, units, t_rgh = launches.modes, run.units, float(launches.gh.t_rgh[0])
    facts = {
        "size": f"M = {units.mass:.4g} kg, a = {1000 * units.length:.4g} mm, "
        f"√(a/g) = {units.time:.4g} s"
        if units
        else "",
        "dissipation": run.losses,
        "launched along": f"{math.degrees(run.launch['psi']):.4g}°",
        "K_p, K_r": f"{m.K_p[0]:.4g}, {m.K_r[0]:.4g}",
        "ω_p, ω_r": ", ".join(
            run.with_unit(of[0], RATE) for of in (m.omega_p, m.omega_r)
        ),
        "t_rGH": run.with_unit(t_rgh, TIME) if np.isfinite(t_rgh) else "none",
        "turns": _listed(course.reversals, ended.t, *time),
        "zeros": _listed(ended.zeros, ended.t, *time)
        if ended.zeros != course.reversals
        else "",
        "integrated by": ", ".join(map(str, run.integrator.values())),
        "status": ended.status.label,
        "beware": course.warning,
    }
    # Exponents keep their hyphen, so that they can be copied into programs.
    return [
        (name, re.sub(r"(?<!e)-", "−", text)) for name, text in facts.items() if text
    ]


def _listed(times: list[float], end: float, size: float, unit: str) -> str:
    shown = ", ".join(f"{size * time:.8g}" for time in times[:6]) + ", ..." * (
        len(times) > 6
    )
    return f"{shown or f'none by {size * end:g}'} {unit}"


def make_page(scene: dict[str, Any], title: str, subtitle: str) -> bytes:
    """Return the page of a scene, with title and subtitle escaped for HTML."""
    table = np.stack([scene["columns"][name] for name in COLUMNS], axis=1)
    arrays = {
        "columns": COLUMNS,
        "table": _encode(table),
        "theory": _encode(scene["theory"]),
    }
    data = json.dumps(scene | arrays, ensure_ascii=False, allow_nan=False)
    folder = files("rattlesweep.analysis.onerun") / "page"
    page, *texts = (
        (folder / name).read_text(encoding="utf-8") for name in ("page.html", *SOURCES)
    )
    style, *scripts = (
        f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"
        for text in texts
    )
    parts = {
        # Forbid all origins, and all scripts and styles but these, identified by their
        # hashes.
        "policy": f"default-src 'none'; script-src {' '.join(scripts)}; style-src {style}; "
        "img-src data:; base-uri 'none'; form-action 'none'",
        "version": html.escape(version("rattlesweep")),
        "title": html.escape(title),
        "subtitle": html.escape(subtitle),
        "data": data.replace(
            "<", "\\u003c"
        ),  # so that the text cannot close its element
        **dict(zip(SOURCES, texts, strict=True)),
    }
    # One pass, so that inserted text is not searched for placeholders.
    return re.sub(r"@@([\w.]+)@@", lambda found: parts[found[1]], page).encode()


def _encode(values: Floats) -> str:
    return base64.b64encode(values.astype("<f4").tobytes()).decode()
