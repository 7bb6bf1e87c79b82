"""One run as a page that moves: the body rolling, its trace and its spin, in one HTML file.

What the page is made of is in `page/`: `page.html`, `page.css`, `scene.js` (what is drawn),
`player.js` (time and controls) and `three.min.js`, a bundle of three.js that `bundle.sh` makes.
Everything is written into the page, which forbids itself the network.
"""

from __future__ import annotations

import base64
import hashlib
import html
import json
import math
import re
from collections.abc import Callable
from dataclasses import dataclass
from importlib.resources import files
from typing import Any

import numpy as np

from rattlesweep.analysis.onerun.channels import si_size
from rattlesweep.analysis.onerun.course import Course, PreparedRun
from rattlesweep.analysis.onerun.rows import EvenTimes, Rows
from rattlesweep.arrays import Floats
from rattlesweep.errors import ConfigError
from rattlesweep.physics.body import PARAMETERS
from rattlesweep.sweeps.launches import Launch
from rattlesweep.sweeps.provenance import package_version

# What is shown of each row, in the order in which the page holds it.
COLUMNS = ("q0", "q1", "q2", "q3", "trace_x", "trace_y", "n", "E_p", "E_r")
CHANNELS = (*COLUMNS, "contact_z", "energy")
# Rows of a period of the pitch.  Between rows the page draws cubics, and the body slips at most at
# 5e-5 of the contact's speed (GH, n = 0.1 and -0.1).  Long runs make do with fewer.
PER_PERIOD, LEAST = 20, 10
# 48 bytes a row in the page, which stays below 5 MB.
MOST_ROWS = 80_000
FEWEST_ROWS = 201
THEORY_POINTS = 800
# The body is cut off above every point of contact of the run, and not below its centre of mass.
MARGIN = 1.25
# Share of an ellipsoid's lower half that is drawn.
WIDEST = 0.99
# Periods of the roll that the trace of the contact shows.
TRAIL = 6
# Seconds that the way to the first reversal takes at the page's first speed, and its bounds.
SECONDS, SLOW, FAST = 30, 4.0, 25.0
# Units of the time and the spin.
UNITS = {"t": "sqrt(a/g)", "n": "sqrt(g/a)"}
# What `page.html` is filled with, the style first.
SOURCES = ("page.css", "three.min.js", "scene.js", "player.js")


@dataclass(frozen=True)
class Scene:
    """All that a page shows of a run."""

    t: Floats  # even times, in sqrt(a/g)
    columns: dict[str, Floats]  # COLUMNS at these times
    theory: Floats  # Garcia and Hubbard's spin at even times over the same span
    about: dict[str, Any]
    """Numbers and words, as JSON can hold them; ``rise`` is the height above its lowest point, in
    units of ``a``, at which the body is cut off."""


def course_of(
    run: Launch | PreparedRun,
    points: int | None = None,
    watch: Callable[[float], None] | None = None,
    *,
    from_time: float | None = None,
) -> Course:
    """Return the run with the channels and the rows that its page needs, or so many ``points``."""
    model = run.model if isinstance(run, Launch) else run[0].model
    if model != "full":
        raise ConfigError(f"the model {model} has no body that moves; show needs the full one")
    if points is not None and not 2 <= points <= MOST_ROWS:
        raise ConfigError(f"--points {points}: 2 to {MOST_ROWS} go into a page")
    rows = Rows(
        points, from_time=from_time, per_period=PER_PERIOD, least=FEWEST_ROWS, most=MOST_ROWS
    )
    course = Course(run, channels=CHANNELS, rows=rows, watch=watch)
    start = from_time or 0.0
    shown = course.t_end - start
    least = math.ceil(LEAST * course.periods * (shown / course.t_end)) + 1
    if points is None and least > MOST_ROWS:
        longest = start + shown * (MOST_ROWS - 1) / least
        raise ConfigError(
            f"t_end {course.t_end:g} is too long for one page; --t-end {math.floor(longest)} or "
            "less goes into it"
        )
    return course


def make_scene(course: Course, cause: str = "") -> Scene:
    """Integrate a course of :func:`course_of`, not yet begun, and gather what its page shows."""
    assert isinstance(course.times, EvenTimes)
    start, step = course.times.start, course.times.step / course.times.parts
    columns = course.columns()
    # A run that came to no good is shown as far as it has numbers.
    good = np.logical_and.reduce([np.isfinite(column) for column in columns.values()])
    rows = len(good) if good.all() else int(np.argmin(good))
    if rows < 2:
        raise ConfigError(f"the run ends at t = {course.t:g}: {course.status.meaning}")
    columns = {name: column[:rows] for name, column in columns.items()}
    t = start + step * np.arange(rows, dtype=np.float64)
    runs, body = course.launches, course.body
    spin = runs.gh.spin(np.linspace(start, t[-1], THEORY_POINTS))
    rise = max(1.0, MARGIN * float(np.max(1 - columns["contact_z"])))
    # An ellipsoid ends at its rim, c above the bottom.
    rise = min(rise, WIDEST * body.get("c", np.inf))
    first = course.zeros[0] if course.zeros else t[-1]
    about = {
        "body": body,
        "start": start,
        "step": step,
        "rise": rise,
        "energy": float(columns["energy"][0]),
        "reversals": [time for time in course.reversals if time >= start],
        "trail": TRAIL * 2 * math.pi / float(runs.modes.omega_r[0]),
        "speed": min(FAST, max(SLOW, (max(first, start) - start) / SECONDS)),
        "weights": _weights(body),
        "units": {name: si_size(name, unit, course.units) for name, unit in UNITS.items()}
        if course.units
        else {"t": (1, "√(a/g)"), "n": (1, "√(g/a)")},
        "facts": _facts(course, cause),
    }
    return Scene(t, {name: columns[name] for name in COLUMNS}, spin, about)


def _weights(b: dict[str, float]) -> list[tuple[float, float, float]]:
    """Return dumbbells (x, y, radius) of a shell-dumbbell body, none of others.

    Their moments are known, not their masses: half the mass is drawn on each axis.
    """
    i_xx, i_yy = b["alpha"] - 1, b["beta"] - 1
    if abs(i_xx + i_yy - b["gamma"]) > 1e-9 * b["gamma"]:
        return []
    r_x, r_y = math.sqrt(2 * i_yy), math.sqrt(2 * i_xx)
    radius = 0.12 / math.sqrt(b["theta"])
    return [(r_x, 0, radius), (-r_x, 0, radius), (0, r_y, radius), (0, -r_y, radius)]


def _facts(course: Course, cause: str) -> list[tuple[str, str]]:
    """Return what there is to know of the run, in words."""
    b, launch, m = course.body, course.launch, course.launches.modes
    method = ", ".join(f"{value:g}" if isinstance(value, float) else str(value)
                       for value in course.integrator.values())  # fmt: skip
    t_rgh, losses = float(course.launches.gh.t_rgh[0]), course.launches
    sigma, rolling = (0.0 if of is None else of[0] for of in (losses.sigma, losses.rolling))
    lossy, more = sigma or rolling, course.zeros != course.reversals
    size = (
        ""
        if (u := course.units) is None
        else (f"M = {u.mass:.4g} kg, a = {1000 * u.length:.4g} mm, √(a/g) = {u.time:.4g} s")
    )
    facts = {
        "α, β, γ": f"{b['alpha']:.5g}, {b['beta']:.5g}, {b['gamma']:.5g}",
        "θ, φ": f"{b['theta']:.5g}, {b['phi']:.5g}",
        "skew ξ": f"{math.degrees(b['xi']):.4g}°",
        "c": f"{b['c']:.5g} (ellipsoid)" if "c" in b else "",
        "size": size,
        "dissipation": f"σ {sigma:.4g}, rolling {rolling:.4g}" if lossy else "",
        "n_i, ω_xy0": f"{launch['n_i']:g}, {launch['omega_xy0']:g}",
        "launched along": f"{math.degrees(launch['psi']):.4g}°",
        "K_p, K_r": f"{float(m.K_p[0]):.4g}, {float(m.K_r[0]):.4g}",
        "ω_p, ω_r": f"{float(m.omega_p[0]):.4g}, {float(m.omega_r[0]):.4g}",
        "t_rGH": f"{t_rgh:.6g}" if math.isfinite(t_rgh) else "none",
        "turns": _listed(course.reversals, course.t),
        "zeros of the spin": _listed(course.zeros, course.t) if more else "",
        "integrated by": method,
        "status": course.status.label,
        "sensitive": cause,
        "beware": course.observer.warning,
    }
    # Exponents keep the hyphen that programs read.
    return [(name, re.sub(r"(?<!e)-", "−", text)) for name, text in facts.items() if text]


def _listed(times: list[float], end: float) -> str:
    more = f" and {len(times) - 6} more" if len(times) > 6 else ""
    return ", ".join(f"{time:.8g}" for time in times[:6]) + more or f"none by {end:g}"


def encode(values: Floats) -> str:
    """Return little-endian float32 as base64."""
    return base64.b64encode(np.ascontiguousarray(values, dtype="<f4").tobytes()).decode()


def make_page(scene: Scene, title: str, subtitle: str) -> bytes:
    """Return the page; what HTML would read as markup in the title and the subtitle is escaped."""
    table = np.stack([scene.columns[name] for name in COLUMNS], axis=1)
    data = scene.about | {
        "columns": COLUMNS,
        "table": encode(table),
        "theory": encode(scene.theory),
    }
    folder = files("rattlesweep.analysis.viewer") / "page"
    page, *texts = ((folder / name).read_text(encoding="utf-8") for name in ("page.html", *SOURCES))
    style, *scripts = (f"'{_digest(text)}'" for text in texts)
    parts = {
        # No origin at all, and no script or style but these, by their hashes.
        "policy": f"default-src 'none'; script-src {' '.join(scripts)}; style-src {style}; "
        "img-src data:; base-uri 'none'; form-action 'none'",
        "version": html.escape(package_version()),
        "title": html.escape(title),
        "subtitle": html.escape(subtitle),
        # Nothing in it can end the element that holds it.
        "data": json.dumps(data, ensure_ascii=False, allow_nan=False).replace("<", "\\u003c"),
        **dict(zip(SOURCES, texts, strict=True)),
    }
    # In one pass, so that what is put in is not searched for places.
    return re.sub(r"@@([\w.]+)@@", lambda found: parts[found[1]], page).encode()


def _digest(text: str) -> str:
    return "sha256-" + base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()


def describe(course: Course) -> str:
    """Return the run in one line of plain text."""
    *values, xi = (course.body[name] for name in PARAMETERS)
    body = ", ".join(f"{sign} {value:.4g}" for sign, value in zip("αβγθφ", values, strict=True))
    if "c" in course.body:
        body += f", c {course.body['c']:.4g}"
    launch = f"n_i {course.launch['n_i']:g}, ω_xy0 {course.launch['omega_xy0']:g}"
    line = f"{body}, ξ {math.degrees(xi):.3g}°; {launch}; units M = a = g = 1"
    return line.replace("-", "−")
