"""Tables of the extremes: rattlesweep compared with independent references.

    python benchmarks/extremes.py [--write]

Prints the tables of benchmarks/extremes.md; ``--write`` replaces them there. The cases
are those of extreme_cases.py, the references those of extrapolation.py and
extreme_cases.py.
"""

import sys
from pathlib import Path

import click

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT / "tests" / "helpers"))

import extreme_cases as extremes  # noqa: E402
import numpy as np  # noqa: E402
import oracle  # noqa: E402

PAGE = ROOT / "benchmarks" / "extremes.md"
BEGIN, END = "<!-- tables: benchmarks/extremes.py --write -->", "<!-- end of tables -->"
TOLERANCE_CASES = [extremes.REFERENCE[k] for k in (0, 8, 33, 35, 38)]
TOLERANCES = [(c, tol) for c in TOLERANCE_CASES for tol in (1e-13, 1e-14, 1e-15)]
BESIDE = (-1e-3, -1e-7, -1e-9, -1e-11, -1e-13, 1e-13, 1e-11, 1e-7)


def pairs(grazing=extremes.GRAZING, count=2):
    """Cases near the touches, at relative distances of the spin from 1e-3 to 1e-13."""
    return [
        extremes.Case(
            f"{name}, touch {k + 1}, {away:+.0e}", body, n * (1 + away), omega, 20.0
        )
        for name, body, omega, direction in grazing
        for k, n in enumerate(extremes.touches(body, omega, direction, count))
        for away in BESIDE
    ]


def number(x):
    """A small number in a table."""
    return "0" if x == 0 else f"{x:.0e}".replace("e-0", "e-").replace("e+0", "e")


def table(heads, rows):
    """A Markdown table."""
    lines = [heads, ["---"] * len(heads), *rows]
    return "\n".join(
        "| " + " | ".join(str(cell) for cell in line) + " |" for line in lines
    )


def ends(answers):
    """Status, type, steps and seconds at both tolerances; one word where they are the
    same.
    """
    words = [f"{a.status}, {a.type}" for a in answers]
    words = words[:1] if words[0] == words[1] else words
    steps = " / ".join(f"{a.n_steps}" for a in answers)
    return [" / ".join(words), steps, " / ".join(f"{a.seconds:.2g}" for a in answers)]


def launch(case):
    """Launch and horizon of a case in a table."""
    return [case.name, f"{case.n_i:g}", f"{case.omega_xy0:g}", f"{case.t_end:g}"]


HEAD = ["case", "n_i", "omega_xy0", "horizon"]
TAIL = ["status, type", "steps", "seconds"]


def reference_table():
    """Short runs against the longdouble reference."""
    rows = []
    for case, answers, t_r, own, off in extremes.against_reference(
        extremes.REFERENCE, True
    ):
        found = f"{t_r:.9g}" if np.isfinite(t_r) else "-"
        n_end = "-" if np.isfinite(t_r) else " / ".join(number(e[1]) for e in off)
        rows.append(
            [
                *launch(case),
                found,
                number(own),
                " / ".join(number(e[0]) for e in off),
                n_end,
                *ends(answers),
            ]
        )
    return table(
        [*HEAD, "t_r", "reference's own", "error", "error of n_end", *TAIL], rows
    )


def growth_table():
    """Long runs against the exact linear motion."""
    rows = [
        [
            *launch(case),
            f"{exponent:.4g}",
            " / ".join(number(abs(e[0])) for e in off),
            " / ".join(number(e[1]) for e in off),
            " / ".join(number(abs(a.energy_drift)) for a in answers),
            *ends(answers),
        ]
        for case, answers, exponent, off in extremes.against_growth(
            extremes.LINEAR, True
        )
    ]
    heads = [
        *HEAD,
        "exponent",
        "error of the exponent",
        "error of the phase",
        "energy drift",
    ]
    return table([*heads, *TAIL], rows)


def type_table():
    """Runs whose type is known."""
    rows = []
    groups = (
        (extremes.DECAY, "SS"),
        (extremes.OVERDAMPED_ROLL, "SS"),
        (extremes.SATURATED, "SW"),
    )
    for cases, kind in groups:
        for case in cases:
            answers = [extremes.ask([case], {"tol": tol})[0] for tol in extremes.TOLS]
            rate = np.linalg.eigvals(
                oracle.jacobian_spin(case.body, case.n_i)
            ).real.max()
            good = all(a.type == kind for a in answers)
            rows.append(
                [
                    *launch(case),
                    f"{rate * case.t_end:.3g}",
                    kind,
                    *ends(answers),
                    "" if good else "**wrong**",
                ]
            )
    return table([*HEAD, "slowest exponent", "type wanted", *TAIL, ""], rows)


def step_table():
    """RK4 with steps too long."""
    rows = []
    for case, kind, steps in extremes.COARSE:
        for dt in steps:
            answer, verdict = extremes.against_fine(case, kind, dt)
            verdict = "**wrong**" if verdict == "wrong" else verdict
            found = f"{answer.t_r:.6g}" if np.isfinite(answer.t_r) else "-"
            rows.append(
                [
                    *launch(case),
                    f"{dt:g}",
                    kind,
                    verdict,
                    answer.type,
                    found,
                    number(abs(answer.energy_drift)),
                ]
            )
    heads = [*HEAD, "dt", "type wanted", "verdict", "type", "t_r", "energy drift"]
    return table(heads, rows)


def tolerance_table():
    """Tolerances below double precision."""
    cases = TOLERANCE_CASES
    answers = extremes.ask(cases, {"tol": 1e-12})
    fine = extremes.refer(cases, answers, 0.5)
    rows = []
    for case, tol in TOLERANCES:
        [answer] = extremes.ask([case], {"tol": tol})
        error = extremes.errors(case, answer, fine, cases.index(case))[0]
        rows.append(
            [
                *launch(case),
                f"{tol:g}",
                number(error),
                f"{answer.status}, {answer.type}",
                answer.n_steps,
                f"{answer.seconds:.2g}",
            ]
        )
    return table([*HEAD, "tol", "error", *TAIL], rows)


def pair_table():
    """Runs near an initial spin at which the spin just touches zero."""
    cases = pairs()
    answers = [extremes.ask(cases, {"tol": tol}) for tol in extremes.TOLS]
    fine = extremes.refer(cases, answers[0], 0.5)
    rows = []
    for away in BESIDE:
        which = [
            k for k, c in enumerate(cases) if float(c.name.rsplit(",", 1)[1]) == away
        ]
        row = [f"{away:+.0e}", len(which)]
        for found in answers:
            off = np.array(
                [extremes.errors(cases[k], found[k], fine, k)[0] for k in which]
            )
            near = np.array([found[k].near_tangencies > 0 for k in which])
            other = off > 1e-3
            largest = number(off[~other].max()) if (~other).any() else "-"
            row += [largest, other.sum(), near.sum(), (other & ~near).sum()]
        rows.append(row)
    heads = [
        "largest error of t_r",
        "another zero",
        "counted as near",
        "another zero, not counted",
    ]
    both = [f"{head}, {tol:g}" for tol in extremes.TOLS for head in heads]
    return table(["n_i off the touch", "runs", *both], rows)


PARTS = {
    "Short runs against the longdouble reference": reference_table,
    "Long runs against the exact linear motion": growth_table,
    "Types": type_table,
    "RK4 with steps too long": step_table,
    "Tolerances below double precision": tolerance_table,
    "Close pairs of zeros": pair_table,
}


@click.command()
@click.option(
    "--write", is_flag=True, help="Put the tables into benchmarks/extremes.md."
)
def main(write):
    """Measure and print the tables."""
    text = "\n\n".join(f"### {head}\n\n{make()}" for head, make in PARTS.items())
    click.echo(text)
    if write:
        page = PAGE.read_text()
        before, rest = page.split(BEGIN)
        PAGE.write_text(f"{before}{BEGIN}\n\n{text}\n\n{END}{rest.split(END)[1]}")


if __name__ == "__main__":
    main()
