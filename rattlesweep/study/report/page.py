"""`report`: a sweep on one self-contained page."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rattlesweep.durations import clock
from rattlesweep.errors import ConfigError
from rattlesweep.study import html
from rattlesweep.study.html import Html
from rattlesweep.study.plots.layout import Layout, read_layout
from rattlesweep.study.plots.registry import Picture, choose_picture, default_kind, fitting
from rattlesweep.study.report.config import config_yaml
from rattlesweep.study.report.facts import Facts, gather, read_once
from rattlesweep.study.style import encode, styled
from rattlesweep.sweeps.cases.plan import Case
from rattlesweep.sweeps.inspect.content_hash import content_hash
from rattlesweep.sweeps.inspect.status import Status, status_of
from rattlesweep.sweeps.inspect.summary import summarise
from rattlesweep.sweeps.store.store import Store

if TYPE_CHECKING:
    import pyarrow as pa

DPI = 120
# Cases shown at once, and at all: each takes some 400 bytes.
OPEN_CASES, MOST_CASES = 40, 2000
# Rows whose hash is worked out for the page: a second or two.
MOST_HASHED = 3_000_000
# On a narrow screen a picture of many panels is looked at piece by piece.
STYLE = Html(
    "<style>#cases th { padding-left: .5rem; } "
    "summary { cursor: pointer; margin: .8rem 0; } "
    "@media (max-width: 44rem) { figure { overflow-x: auto; } "
    "figure img { max-width: none; width: 46rem; } }</style>"
)
WORDS = {
    "fractions": "Shares of the types. Bars are 95 % Wilson intervals. The share above a triangle "
    "is that of the bodies whose steady spin is linearly stable according to theory.",
    "times": "Reversal times of type R: mean, standard deviation and standard error of the mean; "
    "theory is the mean of Garcia and Hubbard's time.",
    "ratio": "Reversal times of type R in units of Garcia and Hubbard's, run by run.",
    "map": "Types, and reversal times in units of Garcia and Hubbard's.",
    "distribution": "All runs together: reversal times about the theory, and types.",
}


def make_report(directory: Path, title: str | None = None) -> bytes:
    """The page of a sweep.

    Parameters
    ----------
    directory
        Of a sweep, whole or still running.
    title
        Of the page; None: the sweep's name.

    Returns
    -------
    bytes
        HTML, self-contained, under 5 MB.

    Raises
    ------
    ConfigError
        The directory is none of a sweep.
    OutputError
        It cannot be read.
    """
    layout = read_layout(directory)
    status = status_of(directory)
    kinds = _kinds(layout)
    hashed = status.runs_done <= MOST_HASHED
    jobs: list[Callable[[Store], Any]] = [
        gather,
        lambda store: summarise(store, _known_cases(layout)),
        *(partial(_count, layout, kind) for kind in kinds),
        *([content_hash] if hashed else []),
    ]
    found = read_once(layout.store, jobs)
    facts, summary = _good(found[0]), _good(found[1])
    pictures = dict(zip(kinds, found[2:], strict=False))
    digest = _good(found[-1]) if hashed else None
    head = [
        STYLE,
        html.paragraph(
            f"A sweep of {facts.runs:,} runs in {len(layout.manifest['cases']):,} cases, "
            f"{_state(status)}. ", _types(facts),
        ),
        html.paragraph("Units are M = a = g = 1.", kind="soft small"),
    ]  # fmt: skip
    sections = [
        ("pictures", "Pictures", _pictures(pictures)),
        ("cases", "Cases", _cases(layout, summary)),
        ("failures", "Failures", _failures(facts, status)),
        ("cost", "Cost", _cost(layout.manifest.dump(), facts, status)),
        ("config", "Config", html.code(config_yaml(_known(layout.manifest["config"])))),
        ("provenance", "Provenance", _provenance(layout, digest)),
        ("notes", "Notes", _notes(layout, facts, status)),
    ]
    return html.page(title or str(layout.manifest["name"]), head, sections)


def _known(config: dict[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in config.items() if value is not None}


def _state(status: Status) -> str:
    if status.state == "complete":
        return "complete"
    return f"{status.state}: {status.runs_done:,} of {status.runs:,} runs are done"


def _types(facts: Facts) -> str:
    good = facts.status["ok"]
    if not good:
        return "None of them is ok."
    parts = [f"{name} {_share(count, good)}" for name, count in facts.types.items()]
    return f"Types: {', '.join(parts)}."


def _share(part: int, whole: int) -> str:
    percent = 100 * part / whole
    # A few of many must not read as none, nor all but a few as all.
    if part and percent < 0.1:
        return "< 0.1 %"
    if part < whole and percent > 99.9:
        return "> 99.9 %"
    return f"{percent:.1f} %"


# ------------------------------------------------------------------------- pictures


def _kinds(layout: Layout) -> list[str]:
    """The pictures that suit a sweep."""
    kinds = [default_kind(layout)]
    left = {name: len(axis.values) for name, axis in layout.axes.items()}
    extra = ("times", "ratio") if kinds[0] != "map" and layout.varying else ()
    extra = (*extra, "distribution")
    return kinds + [k for k in extra if k in fitting(layout, left) and k not in kinds]


def _count(layout: Layout, kind: str, store: Store) -> Picture:
    return choose_picture(replace(layout, store=store), kind)


def _good(result: Any) -> Any:
    """What a job returned; what it raised is raised here."""
    if isinstance(result, BaseException):
        raise result
    return result


def _pictures(pictures: Mapping[str, Picture | BaseException]) -> Html:
    shown: list[Html] = []
    for kind, result in pictures.items():
        with styled():
            try:
                picture: Picture = _good(result)
                figure = picture.figure()
            except ConfigError as error:
                # More panels than a page can show; the others still say what there is.
                shown.append(html.paragraph(f"No picture of {kind}: {error}", kind="soft"))
                continue
            svg, png = encode(figure, "svg", DPI), encode(figure, "png", DPI)
        varies = ", ".join(picture.names) or "all runs"
        shown.append(html.picture(svg, png, f"{kind} by {varies}", WORDS[kind]))
    return html.join(shown)


# ---------------------------------------------------------------------------- cases


def _known_cases(layout: Layout) -> list[Case]:
    name = next((name for name in ("K_p", "K_r") if name in layout.axes), None)
    return [
        Case(c["case"], 0, name, c.get(name or ""), c.get("n_i"), c.get("omega_xy0"))
        for c in layout.manifest["cases"]
    ]


def _cases(layout: Layout, summary: pa.Table) -> Html:
    named = {name for name in ("K_p", "K_r") if name in layout.axes}
    rows = summary.to_pylist()
    head = ["case", *sorted(named), "n_i", "ω_xy0", "runs", "R", "SS", "SW", "unclassified",
            "Bondi", "mean t_r", "± std", "mean t_rGH", "mean t_r/t_rGH", "± error",
            "failed"]  # fmt: skip
    names = ["case", *sorted(named), "n_i", "omega_xy0", "runs", "fraction_R", "fraction_SS",
             "fraction_SW", "fraction_unclassified", "fraction_bondi", "t_r_mean", "t_r_std",
             "t_rgh_mean", "t_r_over_t_rgh_mean", "t_r_over_t_rgh_sem", "failed"]  # fmt: skip
    cells = [[html.number(_number(row[name], name)) for name in names] for row in rows]
    parts = [html.table(head, cells[:OPEN_CASES])]
    if len(cells) > OPEN_CASES:
        more = html.table(head, cells[OPEN_CASES:MOST_CASES])
        last = min(len(cells), MOST_CASES)
        parts.append(
            Html(f"<details><summary>cases {OPEN_CASES} to {last - 1}</summary>{more.text}"
                 "</details>")
        )  # fmt: skip
    if len(cells) > MOST_CASES:
        parts.append(html.paragraph(f"The other {len(cells) - MOST_CASES:,} cases are in ",
                                    "summary.parquet.", kind="soft"))  # fmt: skip
    return html.join(parts)


def _number(value: float | int | None, name: str) -> str:
    if value is None:
        return "–"
    if name.startswith("fraction"):
        return f"{value:.3f}"
    return f"{value:.5g}" if isinstance(value, float) else f"{value:,}"


# ------------------------------------------------------------------ failures and cost


def _failures(facts: Facts, status: Status) -> Html:
    bad = {word: count for word, count in facts.status.items() if word != "ok"}
    parts: list[Html] = []
    if bad:
        rows = [
            [html.key(word), html.number(f"{count:,}"), html.number(_share(count, facts.runs)),
             f"case {facts.first[word][0]}, sample {facts.first[word][1]}"]
            for word, count in sorted(bad.items(), key=lambda item: -item[1])
        ]  # fmt: skip
        parts.append(html.table(["status", "runs", "share", "first of them"], rows))
    else:
        parts.append(html.paragraph(f"None: all {facts.runs:,} runs have status ok."))
    if status.damaged:
        blocks = ", ".join(map(str, status.damaged[:20]))
        parts.append(html.paragraph(f"Unreadable blocks: {blocks}."))
    return html.join(parts)


def _cost(manifest: dict[str, Any], facts: Facts, status: Status) -> Html:
    kernel = float(manifest.get("kernel_seconds", 0.0))
    rows: list[tuple[str, str]] = [("time", f"{_seconds(status.seconds)} in all sessions")]
    expected = manifest.get("expected")
    # Earlier versions kept a guess where there was no pilot.
    if isinstance(expected, dict) and "seconds" in expected and expected.get("pilot_runs"):
        text = _seconds(expected["seconds"])
        if "low" in expected and "high" in expected:
            text += f" ({_seconds(expected['low'])} to {_seconds(expected['high'])})"
        rows.append(("time expected", text))
    rows += [("of it, integration", _seconds(kernel)),
             ("accepted steps", f"{facts.steps:,}"),
             ("time integrated", f"{facts.time:.4g} √(a/g)"),
             ("size of the runs", f"{facts.bytes / 1e6:,.1f} MB, "
              f"{facts.bytes / max(facts.runs, 1):.0f} bytes a run")]  # fmt: skip
    # The times of sessions that were killed are unknown; rates would come out too high.
    whole = status.state == "complete" and kernel > 0
    if whole:
        rows += [("steps per second", f"{facts.steps / kernel:.3g} of integration"),
                 ("runs per second", f"{facts.runs / kernel:,.0f} of integration")]  # fmt: skip
    return html.table(["what", "value"], [[html.key(name), text] for name, text in rows])


def _seconds(value: float) -> str:
    return f"{value:.1f} s" if value < 600 else clock(value)


# ---------------------------------------------------------------- provenance and notes


def _provenance(layout: Layout, digest: str | None) -> Html:
    manifest = layout.manifest
    machine = manifest.get("machine", {})
    rows = [
        ("started", manifest.get("started", "–")),
        ("finished", manifest.get("finished", "–")),
        ("command", " ".join(map(str, manifest.get("command", [])))),
        ("machine", ", ".join(f"{name} {value}" for name, value in machine.items())),
        ("versions", ", ".join(f"{n} {v}" for n, v in manifest.get("versions", {}).items())),
        ("hash of the config", manifest.get("config_hash", "–")),
    ]
    if digest is not None:
        rows.append(("hash of all rows", digest))
    parts = [html.table(["what", "value"], [[html.key(name), str(text)] for name, text in rows])]
    sessions = manifest.get("sessions", [])
    names = ("started", "state", "shard", "host", "threads", "blocks", "seconds")
    cells = [["–" if s.get(name) is None else str(s[name]) for name in names] for s in sessions]
    if cells:
        parts += [html.paragraph("Sessions:"), html.table(names, cells[-200:])]
    return html.join(parts)


def _notes(layout: Layout, facts: Facts, status: Status) -> Html:
    notes = [
        "Shares are of the runs with status ok. Type R reverses by the horizon; SS: the relevant "
        "oscillation decays; SW: the spin leaves its plateau; unclassified: neither.",
        "Bondi: the share of bodies whose steady spin is linearly stable according to theory, "
        "|n_c1| < |n_i|; in the unsteady direction none is.",
        "t_r/t_rGH is taken run by run and averaged over type R; the error is that of the mean.",
    ]
    if status.state != "complete":
        notes.append(
            f"The sweep is not complete ({_state(status)}); the figures here may still change."
        )
    if facts.near_tangencies:
        notes.append(
            f"{facts.near_tangencies:,} extrema of the spin are so close to zero that, at this "
            "tolerance, it is undecided whether the spin crossed zero there."
        )
    doubtful = facts.types["unclassified"]
    if doubtful:
        notes.append(
            f"{doubtful:,} runs are unclassified: their oscillation grows, but the horizon "
            f"{_horizon(layout)} is reached before the spin changes visibly."
        )
    return html.join(html.paragraph(note) for note in notes)


def _horizon(layout: Layout) -> str:
    horizon = layout.config.horizon
    ends = [] if horizon.t_rgh is None else [f"{horizon.t_rgh:g} t_rGH"]
    ends += [] if horizon.t is None else [f"t = {horizon.t:g}"]
    return " or ".join(ends)
