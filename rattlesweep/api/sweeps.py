"""Sweeps: run them, open them, and get their tables, figures, pages and single runs."""

from __future__ import annotations

import html
import os
import warnings
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rattlesweep.api import arguments as arguments
from rattlesweep.api.arguments import check_count, is_table, names_of, to_frame
from rattlesweep.api.trajectories import (
    SHOWN,
    Page,
    Trajectory,
    page_of,
    page_path,
    prepare_stored,
    replay,
)
from rattlesweep.system.console import Bar, counted
from rattlesweep.words.defaults import MOST_SEARCHED, PERIODIC, SEARCH_SECTION
from rattlesweep.words.errors import ConfigError, ConfigWarning, check_names

if TYPE_CHECKING:
    import pandas as pd
    import xarray
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from rattlesweep.analysis.compare import Comparison
    from rattlesweep.analysis.style import Style
    from rattlesweep.design.bodies.table import Frame
    from rattlesweep.store.rows import Stored
    from rattlesweep.work.verify import Verified


class Sweep:
    """The output directory of a sweep, complete or running.

    Its tables are read when they are needed.

    Stability: stable.
    """

    def __init__(self, directory: str | Path) -> None:
        from rattlesweep.system.files import as_path

        # The working directory may change while the sweep is open.
        self.directory = as_path(directory, "directory").absolute()
        _ = self._stored  # raises an error if it is not an output directory

    @property
    def _stored(self) -> Stored:
        # Opened anew each time, as a sweep may grow or get other types meanwhile.
        from rattlesweep.store.rows import open_stored

        return open_stored(self.directory)

    @property
    def manifest(self) -> dict[str, Any]:
        """The content of ``manifest.json``: config, hash, cases, versions, machine."""
        return self._stored.manifest

    @property
    def config(self) -> dict[str, Any]:
        """The config with all defaults filled in."""
        return dict(self.manifest["config"])

    @property
    def runs(self) -> pd.DataFrame:
        """One row for each run, with all columns of ``runs/*.parquet``."""
        return self.read()

    @property
    def summary(self) -> pd.DataFrame:
        """One row for each case, over the runs so far, with units in ``attrs``."""
        from rattlesweep.store.summary import read_summary

        return to_frame(read_summary(self._stored))

    def __getitem__(self, columns: str | list[str]) -> pd.Series | pd.DataFrame:
        """Return a column of the runs as a Series, or several as a DataFrame."""
        return self.read(columns)[columns]

    def read(
        self, columns: Sequence[str] | str | None = None, where: str | None = None
    ) -> pd.DataFrame:
        """Read the runs, or only some of their columns, or those that meet a condition.

        The condition is a pandas query such as ``'type == "SW" and K_r < 0.005'``.  The
        runs are in order of case and sample, with ``attrs["units"]`` and
        ``attrs["descriptions"]``.

        Examples
        --------
        >>> slow = rs.load("out/gh").read(["n_i", "t_r"], where="t_r > 200")
        >>> slow.t_r.round(2).tolist(), slow.attrs["units"]["t_r"]
        ([809.86], 'sqrt(a/g)')
        """
        import pyarrow as pa

        from rattlesweep.analysis.one_table import chosen_batches, schema_of

        stored = self._stored
        names = None
        if columns is not None:
            names = names_of("columns", columns)
        schema = schema_of(stored, names)
        if where is None:
            return to_frame(stored.read(names))
        batches = chosen_batches(stored, schema, where)
        return to_frame(pa.Table.from_batches(batches, schema))

    def to_xarray(
        self,
        columns: Sequence[str] | str | None = None,
        *,
        where: str | None = None,
        fill: bool = False,
    ) -> xarray.Dataset:
        """Return the runs as a Dataset with one dimension for each axis of the sweep.

        Needs xarray (``pip install 'rattlesweep[xarray]'``).  The dimensions are the
        target ``K_p`` or ``K_r`` if there is one (the bodies' own coefficient is then
        ``K_r_body``), ``n_i``, ``omega_xy0``, and the axes of a grid of bodies, or else
        ``sample``.  By default all columns with one value per run are there; a
        ConfigWarning names the columns of lists, which ``read`` has.  Runs for which
        `where` is false are missing: NaN, or an empty text.  With `fill`, points left
        out by ``bodies.refine`` are filled from the nearest runs, numbers by linear
        interpolation.
        """
        from rattlesweep.analysis.dataset import make_dataset
        from rattlesweep.analysis.layout import read_layout

        layout = read_layout(self.directory).chosen(where)
        names = None
        if columns is not None:
            names = names_of("columns", columns)
        elif layout.lists:
            listed = ", ".join(layout.lists)
            text = f"to_xarray: columns of lists are left out: {listed}; see read()"
            warnings.warn(text, ConfigWarning, stacklevel=2)
        return make_dataset(layout, names, fill_refined=fill)

    def plot(
        self,
        kind: str | None = None,
        *,
        x: str | None = None,
        quantity: str | None = None,
        colour: str | None = None,
        panels: str | None = None,
        select: Mapping[str, Any] | Sequence[str] = (),
        where: str | None = None,
        path: str | Path | None = None,
        labels: Mapping[str, str] | str | Path | None = None,
        style: Style = None,
        ax: Axes | None = None,
        **looks: Any,
    ) -> Figure:
        """Draw the sweep as ``rattlesweep plot`` does.

        The arguments are the options of the command; `path` is an .svg, .png or .pdf
        file to write.  `select` may be a mapping, as in ``{"n_i": [-0.3, -0.5]}``;
        looks are ``title``, ``log``, ``size``, ``xlim``, ``ylim`` and ``caption``
        (False leaves it out).  `panels` is the axis of the sweep whose values have
        panels of their own, and `labels`, a mapping or a YAML file, replaces texts of
        the figure, as in ``{"ylabel": "Anteil", "n_i": "Spin"}``; see
        docs/figures.md.

        What differs in ``matplotlib.rcParams`` from Matplotlib's own settings is
        respected, and `style`, a file, a name such as ``"ggplot"`` or a mapping, above
        it.  A picture of a single panel may be drawn on `ax`, axes of the caller's,
        whose figure is returned; the caption is then left to the caller.
        """
        from rattlesweep.analysis.labels import read_labels
        from rattlesweep.analysis.layout import read_layout
        from rattlesweep.analysis.onerun.figure import shown
        from rattlesweep.analysis.plots import choose_picture
        from rattlesweep.analysis.style import save_figure, styled
        from rattlesweep.system.files import as_path

        _check_looks(looks)
        looks["labels"] = read_labels(labels)
        layout = read_layout(self.directory)
        if isinstance(select, Mapping):
            select = [_selection(name, values) for name, values in select.items()]
        texts = names_of("select", select)
        with styled(style):
            picture = choose_picture(
                layout,
                kind,
                x=x,
                quantity=quantity,
                colour=colour,
                panels=panels,
                select=texts,
                where=where,
            )
            if ax is None:
                return shown(picture.figure(**looks), path)
            for name in ("size", "caption"):
                if looks.pop(name, None):
                    raise ConfigError(f"{name}: the figure of ax is the caller's")
            picture.draw_on(ax, **looks)
            figure = ax.get_figure(root=True)
            assert figure is not None
            if path is not None:
                save_figure(figure, [as_path(path, "path")])
            return figure

    def fractions(
        self,
        by: Sequence[str] | str,
        *,
        bins: int = 10,
        where: str | None = None,
    ) -> pd.DataFrame:
        """Return the fractions of the types over bins of any columns of numbers.

        A column of at most `bins` values has a bin for each of them, otherwise the bins
        hold equal numbers of runs; each value of an axis of the sweep, such as ``n_i``,
        is a bin if there are at most 50.  Several columns make a grid of bins.  A row
        has the median and the ends of each column, the number of ``runs``, and each
        fraction with its 95 % interval (Wilson).  In a refined sweep, a run counts for
        the points of the grid that are nearest to it, and ``runs_effective`` is smaller
        than the number of points.

        Examples
        --------
        >>> rs.load("out/gh").fractions("n_i")[["n_i", "runs", "fraction_R"]].values
        array([[-0.1,  1. ,  1. ],
               [ 0.1,  1. ,  1. ]])
        """
        from rattlesweep.analysis.layout import read_layout
        from rattlesweep.analysis.shares import fractions_by

        check_count("bins", bins)
        layout = read_layout(self.directory).chosen(where)
        return fractions_by(layout, names_of("by", by), bins)

    def report(
        self, path: str | Path | None = None, *, title: str | None = None
    ) -> Page:
        """Write one self-contained HTML page, by default DIRECTORY/report.html."""
        from rattlesweep.analysis.report import make_report

        path = self.directory / "report.html" if path is None else page_path(path)
        return Page(make_report(self.directory, title)).save(path)

    def verify(
        self,
        recompute: int = 0,
        *,
        seed: int = 0,
        threads: int | None = None,
        complete: bool = False,
    ) -> Verified:
        """Check all runs against the manifest, and repeat some random ones bit for bit.

        The result has ``problems``, a list of sentences, ``missing``, the number of
        runs that are not there, and ``words``.  With `complete`, missing runs are a
        problem.  Nothing is changed.
        """
        from rattlesweep.work.verify import verify

        check_count("recompute", recompute, 0)
        check_count("seed", seed, 0)
        check_count("threads", threads)
        return verify(self.directory, recompute, seed, threads, complete=complete)

    def compare(self, other: Sweep | str | Path) -> Comparison:
        """Compare with another sweep, as ``rattlesweep compare`` does."""
        from rattlesweep.analysis.compare import compare

        if not isinstance(other, Sweep):
            other = Sweep(other)
        return compare(self.directory, other.directory)

    def classify(self, **thresholds: float) -> pd.DataFrame:
        """Classify the runs anew and return the summary.

        Thresholds, such as ``sw_departure=0.1``, are by default those of the config.
        """
        from rattlesweep.store.classify import classify_stored

        texts = [f"classify.{key}={value!r}" for key, value in thresholds.items()]
        return to_frame(classify_stored(self.directory, texts).summary)

    def replay(self, case: int, sample: int, **settings: Any) -> Trajectory:
        """Integrate one of the runs again as a trajectory, as ``replay`` does."""
        return replay(self.directory, case, sample, **settings)

    def find_orbits(
        self,
        where: str = PERIODIC,
        *,
        most: int = MOST_SEARCHED,
        section: str = SEARCH_SECTION,
        t_end: float | str | None = None,
    ) -> pd.DataFrame:
        """Search the periodic orbits near the ends of runs, and return a row for each.

        The runs are the first `most` that meet `where`, which by default asks for the
        regime ``periodic`` of ``record: [spectrum]``; their `case` and `sample` are
        columns.  A run near which no orbit is found has no row.
        """
        import pandas as pd

        from rattlesweep.analysis.onerun.replay import find_run
        from rattlesweep.analysis.orbits.near_returns import orbits_near
        from rattlesweep.analysis.orbits.tabulated import table_of_orbits

        check_count("most", most)
        keys = self.read(["case", "sample"], where).head(most)
        tables = []
        for case, sample in keys.itertuples(index=False):
            run = find_run(self.directory, int(case), int(sample))
            prepared = run.prepare(arguments.one_number("t_end", t_end, run.units))
            try:
                table = table_of_orbits(orbits_near(prepared, section))
            except ConfigError:
                if len(keys) == 1:
                    raise
                continue
            table.insert(0, "sample", sample)
            table.insert(0, "case", case)
            tables.append(table)
        if not tables:
            raise ConfigError(
                f"where {where}: of {counted(len(keys), 'run')} none ends near an "
                "orbit; give other runs, or a longer t_end"
            )
        found = pd.concat(tables, ignore_index=True)
        found.attrs = tables[0].attrs
        return found

    def show(
        self,
        case: int | None = None,
        sample: int | None = None,
        *,
        where: str | None = None,
        t_end: float | str | None = None,
        title: str | None = None,
        **settings: Any,
    ) -> Page:
        """Make a page of a run, or of the first that meets `where`; see ``show``."""
        stored, run = prepare_stored(
            self.directory, t_end, case=case, sample=sample, where=where
        )
        check_names("arguments", settings, SHOWN)
        if stored.matches > 1:
            warnings.warn(stored.choice, ConfigWarning, stacklevel=2)
        return page_of(run, title or stored.title, **settings)[0]

    def __repr__(self) -> str:
        return f"<Sweep {self.directory}: {self._stored.count():,} runs>"

    def _repr_html_(self) -> str:
        summary = self.summary.dropna(axis="columns", how="all")
        table = summary.to_html(max_rows=10, index=False, float_format="{:.5g}".format)
        return f"<div>{html.escape(repr(self))}{table}</div>"


def _misplaced(key: str) -> str:
    """Return why an argument of :func:`sweep` is refused beside a config."""
    from rattlesweep.config.schema import Config
    from rattlesweep.words.errors import hint

    if key in Config.model_fields:
        return "keys go with a DataFrame only; write it into the config"
    arguments_of_calls = ["config", "output", "threads", "progress"]
    advice = hint(key, arguments_of_calls, "executors are chosen by `rattlesweep run`")
    return f"rs.sweep has no such argument; {advice}"


def _check_looks(looks: Mapping[str, Any]) -> None:
    """Refuse looks of a figure that are unknown, or no pairs where pairs are needed."""
    check_names("looks", looks, ("title", "log", "size", "xlim", "ylim", "caption"))
    for name in ("size", "xlim", "ylim"):
        value = looks.get(name)
        if value is None:
            continue
        if arguments.numbers(name, value).shape != (2,):
            raise ConfigError(
                f"{name}: {arguments.kind_of(value)} is not a pair of numbers"
            )
        if name == "size" and not 1 <= min(value) <= max(value) <= 24:
            raise ConfigError(f"size: {value} is given; 1 to 24 inches are allowed")


def _selection(name: str, values: object) -> str:
    """Return a selection in the form of the command, as in ``n_i=-0.3,-0.5``."""
    if isinstance(values, str) or not isinstance(values, Iterable):
        values = [values]
    return f"{name}={','.join(map(str, values))}"


def load(directory: str | Path) -> Sweep:
    """Open the output directory of a sweep, complete or running.

    Stability: stable.
    """
    return Sweep(directory)


def sweep(
    config: str | Path | Mapping[str, Any] | Frame,
    *,
    output: str | Path | None = None,
    threads: int | None = None,
    progress: bool | None = None,
    **keys: Any,
) -> Sweep:
    """Run a sweep, or resume one; a ConfigWarning says what is doubtful.

    Stability: stable.

    Parameters
    ----------
    config : path, mapping or DataFrame
        A config file, its content, or a table of bodies.  The table has the columns
        ``alpha beta gamma theta phi xi`` and optionally ``n_i omega_xy0 psi t_end``
        (angles in radians), or those in SI units; it is kept in the output directory.
    output : path, optional
        Output directory, which overrides the config's.
    threads, progress
        As for ``simulate``.
    **keys
        For a DataFrame, the other keys of the config, such as ``spin``, ``horizon``,
        ``record``.
    """
    from rattlesweep.compiling.loading import listening
    from rattlesweep.config.read import load_config, parse_config
    from rattlesweep.system.files import as_path
    from rattlesweep.work.planning import checked_plan, plan_frame
    from rattlesweep.work.run import run_sweep

    check_count("threads", threads)
    target: Path | None = None
    if output is not None:
        target = as_path(output, "output")
    base: Path | None = None
    if is_table(config):
        plan, target, base, doubts = plan_frame(config, target, keys)
    else:
        for key in keys:
            raise ConfigError(f"{key}: {_misplaced(key)}")
        if isinstance(config, str | os.PathLike):
            loaded = load_config(config)
            base = as_path(config, "config").resolve().parent
        else:
            loaded = parse_config(config)  # type: ignore[arg-type]
        plan, doubts = checked_plan(loaded, base)
        target = target or as_path(loaded.directory, "output")
    for doubt in doubts:
        warnings.warn(doubt, ConfigWarning, stacklevel=2)
    with Bar.of_call(progress) as bar, listening(bar.compiling):
        run_sweep(plan, target, base=base, threads=threads, report=bar)
    return Sweep(target)
