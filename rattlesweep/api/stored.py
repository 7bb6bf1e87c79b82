"""A sweep that is on disk: its tables, pictures, pages and runs."""

from __future__ import annotations

import html
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rattlesweep.api.arrays import to_frame
from rattlesweep.api.pages import Page
from rattlesweep.api.single import replay
from rattlesweep.errors import ConfigError

if TYPE_CHECKING:
    import pandas as pd
    import pyarrow as pa
    import xarray
    from matplotlib.figure import Figure

    from rattlesweep.analysis.onerun.course import Trajectory

LOOKS = ("title", "log", "size", "xlim", "ylim")
# Dots per inch of what a notebook shows.
DPI = 110.0


class Sweep:
    """An output directory; tables are read when they are asked for.

    Parameters
    ----------
    directory : path
        Of a sweep, whole or still running.

    Attributes
    ----------
    directory : Path
    manifest : dict
        The resolved config, its hash, versions, machine and times, as they were when it was opened.
    """

    def __init__(self, directory: str | Path) -> None:
        from rattlesweep.sweeps.stored import open_stored

        self.directory = Path(directory)
        self._stored = open_stored(self.directory)
        self.manifest: dict[str, Any] = self._stored.manifest
        self._files: tuple[Any, ...] = ()
        self._columns: dict[str, pa.ChunkedArray] = {}

    @property
    def runs(self) -> pd.DataFrame:
        """One row a run: all columns of ``runs/*.parquet``; no rows before the first block."""
        return self.read()

    @property
    def summary(self) -> pd.DataFrame:
        """One row a case, with units in ``attrs``; of a sweep under way, of its blocks so far."""
        return to_frame(self._stored.summary())

    def read(
        self, columns: Sequence[str] | str | None = None, where: str | None = None
    ) -> pd.DataFrame:
        """Runs, some of their columns, those for which a condition is true.

        Files are read once and every block is proved undamaged; as long as they stay as they are,
        columns that were read before come from memory.

        Parameters
        ----------
        columns : str or sequence of str, optional
            Columns of ``runs``, in this order; by default all.
        where : str, optional
            A pandas query, as of ``rattlesweep plot --where``: ``'type == "SW" and K_r < 0.005'``.

        Returns
        -------
        pandas.DataFrame
            One row a run, in the order of cases and samples, with ``attrs["units"]`` and
            ``attrs["descriptions"]``.

        Examples
        --------
        >>> import rattlesweep as rs
        >>> sweep = rs.load("out/gh")
        >>> slow = sweep.read(["n_i", "t_r"], where="t_r > 200")
        >>> slow.t_r.round(2).tolist(), slow.attrs["units"]["t_r"]
        ([809.86], 'sqrt(a/g)')
        """
        import pyarrow as pa

        from rattlesweep.analysis.where import parse_where
        from rattlesweep.sweeps.config.messages import not_one_of

        schema = self._stored.schema
        names = schema.names if columns is None else columns
        names = [names] if isinstance(names, str) else list(names)
        for name in names:
            if name not in schema.names:
                raise ConfigError(f"columns: {not_one_of(str(name), schema.names)}")
        condition = None if where is None else parse_where(where, schema, "where")
        needed = dict.fromkeys((*names, *(condition.columns if condition else ())))
        found = self._cached(list(needed), schema)
        fields = pa.schema([schema.field(name) for name in needed])
        table = pa.Table.from_arrays([found[name] for name in needed], schema=fields)
        if condition is not None:
            kept = [condition.filter(rows) for rows in table.to_batches()]
            table = pa.Table.from_batches(kept, table.schema)
        return to_frame(table.select(names))

    def _cached(self, names: list[str], schema: pa.Schema) -> dict[str, pa.ChunkedArray]:
        """Columns of all blocks in place, read anew where files have changed."""
        stats = [(path.name, path.stat()) for path in self._stored.files()]
        files = tuple((i, s.st_ino, s.st_mtime_ns, s.st_size) for i, s in stats)
        if files != self._files:
            self._files, self._columns = files, {}
        if absent := [name for name in names if name not in self._columns]:
            table = self._stored.read(absent)
            self._columns |= dict(zip(absent, table.columns, strict=True))
        return self._columns

    def to_xarray(
        self,
        columns: Sequence[str] | None = None,
        *,
        where: str | None = None,
        fill: bool = False,
    ) -> xarray.Dataset:
        """Runs along what varies: one dimension for each axis of the sweep.

        Needs xarray (``pip install 'rattlesweep[xarray]'``).

        Parameters
        ----------
        columns : sequence of str, optional
            Columns of ``runs``; by default all that hold one value a run.
        where : str, optional
            A condition as for :meth:`read`; other runs are missing.
        fill : bool
            Whether the points that ``bodies.refine`` has left out are filled from the nearest runs,
            numbers by linear interpolation between them.

        Returns
        -------
        xarray.Dataset
            Dimensions are the target ``K_p`` or ``K_r`` if there is one, ``n_i``, ``omega_xy0``,
            and the axes of a grid of bodies by their names, else ``sample``; coordinates ascend.
            Each variable has ``units`` and ``long_name``.  Runs that are not stored are NaN, or
            empty words.  Beside an axis of targets, the bodies' own coefficient is ``K_r_body``.

        Examples
        --------
        >>> import rattlesweep as rs
        >>> runs = rs.load("out/gh").to_xarray(["t_r", "type"]).squeeze()
        >>> runs.t_r.sel(n_i=-0.1).round(2).item(), runs.t_r.attrs["units"]
        (809.86, 'sqrt(a/g)')
        """
        from rattlesweep.analysis.dataset import make_dataset
        from rattlesweep.analysis.plots.layout import read_layout

        return make_dataset(
            read_layout(self.directory).chosen(where), columns, fill_refined=fill
        )

    def plot(
        self,
        kind: str | None = None,
        *,
        x: str | None = None,
        quantity: str | None = None,
        select: Mapping[str, Any] | Sequence[str] = (),
        where: str | None = None,
        path: str | Path | None = None,
        **looks: Any,
    ) -> Figure:
        """Draw the sweep, as ``rattlesweep plot`` does.

        Parameters
        ----------
        kind : str, optional
            ``fractions``, ``times``, ``ratio``, ``map``, ``reversals``, ``distribution`` or
            ``scatter``; by default what suits the sweep.
        x : str, optional
            What goes along the abscissa: something that varies, or a column for a scatter.
        quantity : str, optional
            The column that a map or a distribution shows.
        select : mapping or sequence of str
            Only these values, such as ``{"n_i": [-0.3, -0.5], "theta": "0.6:0.7"}``.
        where : str, optional
            A condition on the runs, as for :meth:`read`.
        path : path, optional
            An .svg, .png or .pdf file to write it to as well.
        **looks
            ``title``, ``log``, ``size`` in inches, ``xlim`` and ``ylim``.

        Returns
        -------
        matplotlib.figure.Figure
            Shown by a notebook; ``savefig`` writes it.

        Examples
        --------
        >>> import rattlesweep as rs
        >>> figure = rs.load("out/gh").plot("distribution", path="distribution.svg")
        """
        from rattlesweep.analysis.plots.kinds import choose_picture
        from rattlesweep.analysis.plots.layout import read_layout
        from rattlesweep.analysis.style import FORMATS, encode, save, styled

        for name in looks:
            if name not in LOOKS:
                raise ConfigError(f"{name}: unknown; the looks of a picture are {', '.join(LOOKS)}")
        endings = [f".{kind}" for kind in FORMATS]
        if path is not None and Path(path).suffix.lower() not in endings:
            raise ConfigError(f"path {path}: the name must end in {', '.join(endings)}")
        if isinstance(select, Mapping):
            select = [f"{name}={_values(value)}" for name, value in select.items()]
        elif isinstance(select, str):
            select = [select]
        with styled():
            layout = read_layout(self.directory)
            picture = choose_picture(
                layout, kind, x=x, quantity=quantity, select=select, where=where
            )
            figure = picture.figure(**looks)
            if path is not None:
                save(figure, [Path(path)], 150.0)
        # A figure that is none of pyplot's is shown by no notebook unless it says how.
        setattr(figure, "_repr_png_", lambda: encode(figure, "png", DPI))  # noqa: B010
        return figure

    def report(self, path: str | Path | None = None, *, title: str | None = None) -> Page:
        """Write one self-contained HTML page about the sweep.

        Parameters
        ----------
        path : path, optional
            By default ``report.html`` in the directory.
        title : str, optional

        Returns
        -------
        Page
            Its ``path``; a notebook shows the page.

        Examples
        --------
        >>> import rattlesweep as rs
        >>> rs.load("out/gh").report().path.name
        'report.html'
        """
        from rattlesweep.analysis.report import make_report
        from rattlesweep.sweeps.files import replace_file

        target = Path(path) if path is not None else self.directory / "report.html"
        replace_file(target, make_report(self.directory, title))
        return Page(target)

    def replay(self, case: int, sample: int, **rows: Any) -> Trajectory:
        """Integrate one of its runs again as a trajectory: :func:`rattlesweep.replay` of it.

        Examples
        --------
        >>> import rattlesweep as rs
        >>> path = rs.load("out/gh").replay(0, 0, channels=("t", "n"), points=5)
        >>> path.reversals.round(2)
        array([112.09])
        """
        return replay(self.directory, case, sample, **rows)

    def show(
        self,
        case: int | None = None,
        sample: int | None = None,
        *,
        where: str | None = None,
        path: str | Path | None = None,
        t_end: float | None = None,
        from_time: float | None = None,
        points: int | None = None,
        title: str | None = None,
    ) -> Page:
        """Write a page on which the body of one of its runs rolls on the plane.

        Parameters
        ----------
        case, sample : int, optional
            Which run.
        where : str, optional
            Instead of these, a condition: the first run for which it is true.
        path : path, optional
            By default ``show-CASE-SAMPLE.html`` in the directory.
        t_end, from_time : float, optional
            Where it ends and begins, in ``sqrt(a/g)``; by default the sweep's horizon and 0.
        points : int, optional
            Number of rows.
        title : str, optional

        Returns
        -------
        Page
            Its ``path``; a notebook shows the page.

        Raises
        ------
        ConfigError
            If there is no such run, its model has no body that moves, or an argument is wrong.
        OutputError
            If the run is not stored yet, or does not come out as stored, bit for bit.

        Examples
        --------
        >>> import rattlesweep as rs
        >>> rs.load("out/gh").show(0, 0, t_end=20).path.name
        'show-0-0.html'
        """
        from rattlesweep.analysis.onerun.replay import Replay
        from rattlesweep.analysis.viewer import show

        source = Replay(self.directory)
        run = source.select(case, sample, where)[0]
        target = self.directory / f"show-{run.case}-{run.sample}.html"
        target = target if path is None else Path(path)
        show.save_stored(source, run, target, title, t_end, points=points, from_time=from_time)
        return Page(target)

    def __repr__(self) -> str:
        """Name the directory and how many runs it holds."""
        return f"<Sweep {self.directory}: {self._stored.count()} runs>"

    def _repr_html_(self) -> str:
        """What a notebook shows: the same, and the first cases of the summary."""
        head = html.escape(
            f"{self.manifest['name']}: {self._stored.count():,} runs in {self.directory}"
        )
        summary = self.summary.dropna(axis="columns", how="all")
        table = summary.to_html(max_rows=10, index=False, float_format=lambda x: f"{x:.5g}")
        return f"<div><strong>rattlesweep</strong> {head}{table}</div>"


def _values(value: Any) -> str:
    """Values as ``--select`` has them: a text as it is, a number, or several."""
    if isinstance(value, str):
        return value
    try:
        return ",".join(repr(float(each)) for each in value)
    except TypeError:
        return repr(value)
