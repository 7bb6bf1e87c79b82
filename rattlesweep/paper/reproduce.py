"""Every figure and supplement by its name, and how they are made, one after another."""

from __future__ import annotations

import io
import time
from collections.abc import Callable, Sequence

import pyarrow as pa
import pyarrow.parquet as pq

from rattlesweep.analysis.style import encode, styled
from rattlesweep.errors import ConfigError
from rattlesweep.paper import fig3_4, fig5, fig6_8, fig7, fig9, friction
from rattlesweep.paper.claim import judge
from rattlesweep.paper.report import Reproduction, write_report
from rattlesweep.paper.workspace import FULL, Part, Workspace
from rattlesweep.sweeps.config.messages import not_one_of
from rattlesweep.sweeps.files import replace_file

# The claims about formulas alone go by this name where parts are chosen.
THEORY = "theory"
KINDS, DPI = ("png", "svg"), 150

PARTS = {
    "fig3": Part(
        "Fig. 3: frequencies",
        "Cumulative distributions of the pitch and roll frequencies of random shell-dumbbell "
        "bodies, exact and to zeroth order in the skew angle. Inset: their ratio, with the paper's "
        "lower bound.",
        fig3_4.frequencies,
        fig3_4.draw_frequencies,
    ),
    "fig4": Part(
        "Fig. 4: asymmetric torque coefficients",
        "(a) Cumulative distributions of K_p and K_r. (b) Relative frequency of pairs (K_p, K_r).",
        fig3_4.coefficients,
        fig3_4.draw_coefficients,
    ),
    "fig5": Part(
        "Fig. 5: the body GH in both directions",
        "Spin and angular velocities in (a) the unsteady and (b) the steady direction. Dashed: "
        "Garcia and Hubbard's solution; dotted: the first reversal.",
        fig5.data,
        fig5.draw,
    ),
    "fig6": Part(
        "Fig. 6: time of reversal in the unsteady direction",
        "(a) Mean over the runs of each point; bars are one standard deviation, lines Garcia and "
        "Hubbard's formula at the mean n_0. (b) A run of GH.",
        fig6_8.unsteady,
        fig6_8.draw_unsteady,
    ),
    "fig7": Part(
        "Fig. 7: types in the steady direction",
        "(a) Fractions of the types; bars are 95 % confidence intervals (Wilson). Filled "
        "triangles: fraction of the bodies whose Bondi threshold lies below the spin. (b) Examples "
        "from the sweep, listed in fig7_examples.parquet.",
        fig7.data,
        fig7.draw,
    ),
    "fig8": Part(
        "Fig. 8: time of reversal in the steady direction",
        "Mean over the runs of type R; bars are one standard deviation, lines Garcia and Hubbard's "
        "formula at the mean n_0.",
        fig6_8.steady,
        fig6_8.draw_steady,
    ),
    "fig9": Part(
        "Fig. 9: three long runs",
        "Spin of GH with other curvatures theta. Dashed: the reduced model (Eqs. (47) [diff-ne-1] "
        "to (49) [diff-ne-3]), started with the same energy of the pitch and a little of the roll.",
        fig9.data,
        fig9.draw,
    ),
    "fig9_volume": Part(
        "Supplement to Fig. 9: phase volume",
        "Natural logarithm of the phase volume that moves along with each run of Fig. 9; "
        "Liouville's theorem would keep it at zero.",
        fig9.volumes,
        fig9.draw_volumes,
    ),
    "fig9_lyapunov": Part("Supplement to Fig. 9: Lyapunov exponents", "", fig9.exponents),
    "friction": Part(
        "Supplement: reversals under friction",
        "Bodies of SD spun both ways at abs(n_i) = 0.3 with a push of 0.01, under a torque of "
        "friction -sigma omega, until at most 0.2 % of the energy is left.",
        friction.data,
        friction.draw,
    ),
}


def choose(names: str | None) -> list[str]:
    """Return the parts that were asked for, such as ``fig8,fig7``, in the paper's order, or all."""
    known = [*PARTS, THEORY]
    wanted = known if names is None else [word.strip() for word in names.split(",")]
    if unknown := [word for word in wanted if word not in known]:
        raise ConfigError(f"--only: {not_one_of(unknown[0], known)}")
    return [name for name in known if name in wanted]


def reproduce(
    workspace: Workspace, names: Sequence[str], begin: Callable[[str], None] = lambda title: None
) -> Reproduction:
    """Compute and draw what was asked for, judge the claims that this can settle, and report.

    `names` are keys of :data:`PARTS`, and perhaps ``theory``; `begin` is called with the title of
    each part before it is made.  Raises a ConfigError if the directory holds other sweeps.
    """
    done = Reproduction(workspace, {name: PARTS[name] for name in names if name != THEORY})
    for name, part in done.parts.items():
        begin(part.title)
        start = time.perf_counter()
        tables = done.tables[name] = part.data(workspace)
        for table, rows in tables.items():
            found = pa.Table.from_pandas(rows, preserve_index=False).replace_schema_metadata()
            buffer = io.BytesIO()
            pq.write_table(found, buffer, write_page_checksum=True)
            replace_file(workspace.directory / f"{name}_{table}.parquet", buffer.getvalue())
        if part.draw is not None:
            with styled():
                drawing = part.draw(tables)
                for kind in KINDS:
                    image = encode(drawing, kind, DPI)
                    replace_file(workspace.directory / f"{name}.{kind}", image)
        done.seconds[name] = time.perf_counter() - start
    few = workspace.sizes.samples < FULL.samples
    done.claims = judge(done.tables, theory=THEORY in names, few=few)
    write_report(done)
    return done
