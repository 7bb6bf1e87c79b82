"""`rattlesweep trajectory`: one run as a time series, in a file, a figure or the terminal."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import click

from rattlesweep.cli.common import DONE, SOME_FAILED, guarded, say


@click.command(
    epilog="\b\nExamples:\n  rattlesweep trajectory --preset GH --n-i -0.1 --t-end 1500 "
    "--figure spin.svg\n  rattlesweep trajectory --preset GH --theta 0.82 --t-end 2e4 --dt 0.5 "
    "--channels t,n,E_p,E_r --output run.parquet"
)
@click.option("--preset", metavar="NAME", help="A named body: GH (Garcia and Hubbard 1988).")
@click.option("--alpha", type=float, help="I_xx + 1, in M a^2.")
@click.option("--beta", type=float, help="I_yy + 1, in M a^2.")
@click.option("--gamma", type=float, help="I_zz, in M a^2.")
@click.option(
    "--f-sd", type=float, help="I_yy/I_zz of a shell-dumbbell body; replaces alpha, beta."
)
@click.option("--theta", type=float, help="Larger principal curvature, in 1/a.")
@click.option("--phi", type=float, help="Smaller principal curvature, in 1/a.")
@click.option("--xi", type=float, help="Skew angle in radians.")
@click.option("--xi-deg", type=float, help="Skew angle in degrees.")
@click.option("--n-i", type=float, default=0.1, show_default=True, help="Initial spin.")
@click.option("--omega-xy0", type=float, default=0.01, show_default=True, help="Oscillation.")
@click.option(
    "--psi",
    default="relevant",
    show_default=True,
    metavar="DIRECTION",
    help="Of the oscillation: relevant, pitch, roll, or degrees.",
)
@click.option("--t-end", type=float, help="Horizon, in sqrt(a/g); by default 5 t_rGH.")
@click.option(
    "--points", type=int, help="So many rows, even from 0 to the horizon. [default: 2001]"
)
@click.option("--dt", type=float, help="A row every DT.")
@click.option("--steps", is_flag=True, help="A row at every accepted step.")
@click.option(
    "--channels",
    default="t,n",
    show_default=True,
    metavar="A,B,...",
    help="Columns; 'list' prints what there is.",
)
@click.option("--method", help="Method. [default: dop853]")
@click.option("--tol", type=float, help="Tolerance of an adaptive method. [default: 1e-9]")
@click.option("--dt-step", type=float, help="Step of a fixed-step method. [default: 0.002]")
@click.option(
    "--accuracy",
    type=click.Choice(["draft", "standard", "reference"]),
    help="Instead of a method and its tolerance.",
)
@click.option(
    "--model",
    type=click.Choice(["full", "reduced", "gh"]),
    default="full",
    show_default=True,
    help="Equations.",
)
@click.option("--e-p0", type=float, help="Energy of the pitch at the start of the reduced model.")
@click.option("--e-r0", type=float, help="Energy of the roll, likewise.")
@click.option("--output", metavar="FILE", help="A .parquet or .csv file instead of CSV printed.")
@click.option("--figure", metavar="FILE", help="Draw it: .svg, .png or .pdf.")
@click.option("-q", "--quiet", is_flag=True, help="No progress and no closing line.")
@guarded
def trajectory(
    channels: str,
    output: str | None,
    figure: str | None,
    quiet: bool,
    method: str | None,
    tol: float | None,
    dt_step: float | None,
    accuracy: str | None,
    points: int | None,
    dt: float | None,
    steps: bool,
    **given: Any,
) -> int:
    """Integrate one launch past its reversals and give it as a time series.

    Prints CSV unless a file or a figure is asked for; the reversal times go to standard error.
    """
    from rattlesweep.study import trajectory_figure as figures
    from rattlesweep.study import trajectory_file as files
    from rattlesweep.study.channels import CHANNELS
    from rattlesweep.study.trajectory import Course
    from rattlesweep.sweep.derived import make_body

    if channels == "list":
        for c in CHANNELS.values():
            models = "" if "gh" in c.models else f" ({', '.join(c.models)})"
            click.echo(f"{c.name:<12}  {c.unit:<9}  {c.description}{models}")
        return DONE
    launch: dict[str, Any] = {
        name: given.pop(name)
        for name in ("n_i", "omega_xy0", "t_end", "model", "e_p0", "e_r0", "psi")
    }
    launch["psi"] = _number(launch["psi"])
    chosen = {"method": method, "tol": tol, "dt": dt_step, "accuracy": accuracy}
    launch["integrator"] = {name: value for name, value in chosen.items() if value is not None}
    body = make_body(given)
    if output is not None:
        files.check_target(Path(output), "--output", files.ENDINGS)
    if figure is not None:
        files.check_target(Path(figure), "--figure", figures.ENDINGS)
    to_files = output is not None or figure is not None
    with _Bar(quiet, files=to_files) as bar:
        names = [name.strip() for name in channels.split(",") if name.strip()]
        if figure is None or output is not None:
            course = Course(body, channels=names, points=points, dt=dt, steps=steps, watch=bar,
                            **launch)  # fmt: skip
            if output is not None:
                files.save(course, Path(output))
            else:
                out = sys.stdout.buffer
                files.write_csv(course, out.write)
                out.flush()
        if figure is not None:
            course = figures.course_for(body, launch, watch=bar)
            figures.save(course, Path(figure))
    if not quiet:
        say(_closing(course.reversals, course.t, course.n_steps))
    if course.status.label != "ok":
        say(f"the run is not ok: {course.status.label}, {course.status.meaning}")
        return SOME_FAILED
    return DONE


def _number(text: str) -> str | float:
    try:
        return float(text)
    except ValueError:
        return text


def _closing(reversals: list[float], t: float, steps: int) -> str:
    shown = ", ".join(f"{time:.10g}" for time in reversals[:8])
    more = f" and {len(reversals) - 8} more" if len(reversals) > 8 else ""
    word = "reversal" if len(reversals) == 1 else "reversals"
    at = f" at {shown}{more}" if reversals else ""
    return f"{len(reversals) or 'no'} {word}{at}; {steps} steps to t = {t:g}"


class _Bar:
    """Progress: a bar on a terminal, unless the data goes there too."""

    def __init__(self, quiet: bool, *, files: bool) -> None:
        self._shown = not quiet and sys.stderr.isatty() and (files or not sys.stdout.isatty())
        self._bar: Any = None

    def __enter__(self) -> _Bar:
        if self._shown:
            from tqdm import tqdm

            self._bar = tqdm(total=100.0, bar_format="{percentage:3.0f}%|{bar}|", file=sys.stderr)
        return self

    def __exit__(self, *error: object) -> None:
        if self._bar is not None:
            self._bar.close()

    def __call__(self, share: float) -> None:
        if self._bar is not None:
            self._bar.n = 100.0 * share
            self._bar.refresh()
