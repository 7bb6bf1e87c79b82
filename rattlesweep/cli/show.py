"""`rattlesweep show`: one run as a page that moves."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from rattlesweep.cli import options
from rattlesweep.cli.common import guarded, say
from rattlesweep.cli.series import Share, close

if TYPE_CHECKING:
    from rattlesweep.study.onerun.course import PreparedRun
    from rattlesweep.study.onerun.replay import StoredRun
    from rattlesweep.sweeps.blocks.single import Launch


@click.command(
    epilog="\b\nExamples:\n  rattlesweep show --preset GH --n-i -0.1 --output spin.html\n"
    "  rattlesweep show --from out/quickstart --where \"type = 'SW'\" --output wobble.html"
)
@click.option("--from", "directory", metavar="DIR", help="Replay a run of this sweep.")
@options.which_options
@options.body_options
@options.spin_options
@options.psi_option
@click.option(
    "--t-end", type=float, help="Horizon, in sqrt(a/g); by default 5 t_rGH, or the run's."
)
@click.option("--points", type=int, help="Number of rows. [default: 20 per pitch period]")
@options.integrator_options
@options.title_option
@click.option("--output", metavar="FILE", required=True, help="An .html file.")
@options.quiet_option
@click.pass_context
@guarded
def show(
    context: click.Context,
    directory: str | None,
    case: int | None,
    sample: int | None,
    where: str | None,
    t_end: float | None,
    points: int | None,
    title: str | None,
    output: str,
    quiet: bool,
    **given: Any,
) -> int:
    """Write an HTML page on which the body rolls on the plane, with its trace and its spin.

    It needs a browser but no network. Play, pause, change the speed, drag to look around; the page
    lists its keys.
    """
    from rattlesweep.study.onerun.files import check_target
    from rattlesweep.study.viewer import show as pages

    path = Path(output)
    options.check_title(title)
    check_target(path, "--output", (".html",))
    run: StoredRun | None = None
    prepared: Launch | PreparedRun
    with Share(quiet, files=True) as bar:
        if directory is not None:
            _refuse(context, given)
            prepared, run, name = _stored(directory, case, sample, where, t_end)
        else:
            prepared = _launched(case, sample, where, t_end, given)
            name = " ".join(["Rattleback", *([given["preset"]] if given["preset"] else [])])
        course = pages.course_of(prepared, points, bar)
        scene = pages.make_scene(course)
    if run is not None:
        run.check(course)
    pages.save(scene, path, title or name, pages.describe(course))
    click.echo(path)
    if not quiet:
        if run is not None:
            say(run.proof)
        say(f"{len(scene.t)} rows, {path.stat().st_size / 1e6:.1f} MB")
    return close(course, quiet)


def _stored(
    directory: str, case: int | None, sample: int | None, where: str | None, t_end: float | None
) -> tuple[PreparedRun, StoredRun, str]:
    """A run of a sweep, proved, and what to call it."""
    from rattlesweep.study.onerun.replay import Replay
    from rattlesweep.study.viewer.show import check_model

    source = Replay(Path(directory))
    check_model(source.config.model)
    run = source.select(case, sample, where)[0]
    source.prove(run)
    kind = f", type {run.type}" if run.type else ""
    return source.prepare(run, t_end), run, f"{source.config.name}: {run.name}{kind}"


def _launched(
    case: int | None,
    sample: int | None,
    where: str | None,
    t_end: float | None,
    given: dict[str, Any],
) -> Launch:
    """A body and a launch given on the command line."""
    from rattlesweep.errors import ConfigError
    from rattlesweep.study.derived import make_body
    from rattlesweep.sweeps.blocks.single import Launch

    if case is not None or sample is not None or where is not None:
        raise ConfigError("--case, --sample and --where go with --from")
    body = make_body({name: given[name] for name in options.BODY})
    rest = {name: value for name, value in given.items() if name not in options.BODY}
    integrator = options.integrator_of(rest)
    psi = options.psi_of(rest.pop("psi"))
    return Launch(body, t_end=t_end, psi=psi, integrator=integrator, **rest)


def _refuse(context: click.Context, given: dict[str, Any]) -> None:
    """Complain of a body or a launch beside `--from`."""
    from rattlesweep.errors import ConfigError

    for name in given:
        source = context.get_parameter_source(name)
        if source is click.core.ParameterSource.COMMANDLINE:
            option = "--" + name.replace("_", "-")
            raise ConfigError(f"{option} does not go with --from: the sweep says what the run was")
