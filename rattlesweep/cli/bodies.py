"""Commands about one body: its quantities, its patch of contact, its mesh."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from click import option

from rattlesweep.cli import options
from rattlesweep.cli.given import body_of, names_of_options, stone_or_options
from rattlesweep.cli.options import (
    Given,
    command,
    flag,
    pick,
    print_result,
    probe_files,
    say,
    tell,
    warn,
)
from rattlesweep.system.console import align
from rattlesweep.words.defaults import FINENESS, PATCH_FRICTION, PATCH_SPIN
from rattlesweep.words.errors import ConfigError
from rattlesweep.words.units import readable_unit

if TYPE_CHECKING:
    from rattlesweep.analysis.derived import DerivedQuantity
    from rattlesweep.physics.body import Rattleback


LEAST_FINENESS = 24  # below it the foot is a facet
MOST_FINENESS = 400  # 1.3 million triangles


@command(
    "One run",
    "rattlesweep body --gamma 10 --f-sd 0.1 --theta 0.8 --phi 0.05 --xi-deg -3",
    "rattlesweep body --half-ellipsoid 12cm,3cm,12mm --mass 60g --skew 3deg "
    "--n-i 60rpm",
    "rattlesweep body --mass 85g --height 1cm --inertia '60,900,920,-20 g cm^2' "
    "--radii '50,1.5 cm' --n-i 60rpm",
    "rattlesweep body --mesh stone.stl --unit mm --mass 60g --n-i 60rpm",
)
@options.body_options
@options.spin_options
@options.dissipation
@options.base
@options.file(
    "--figure",
    *options.PICTURES,
    help="Also draw the mesh at rest and the part of its bottom that was fitted.",
)
@options.as_json
def body(as_json: bool, figure: Path | None, **given: Any) -> None:
    """Print the derived quantities of a body: modes, thresholds, reversal times.

    Spin and oscillation matter for the reversal times only. A body in SI units gets all
    quantities in both systems, with g = 9.81 m/s^2.
    """
    from rattlesweep.analysis.advice import weights_for_skew
    from rattlesweep.analysis.derived import (
        COMMON_FRICTION,
        SLIPS_AT_REVERSAL,
        derived,
    )
    from rattlesweep.api.arguments import (
        columns_of_base,
        one_number,
        require_units,
    )
    from rattlesweep.config.clashes import refuse_slip_beside

    probe_files(figure)
    of_mesh = {name: given[name] for name in options.BODY if given[name] is not None}
    if figure is not None and "mesh" not in of_mesh:
        raise ConfigError("--figure shows a mesh; add --mesh, or leave it out")
    described = body_of(given)
    drive = pick(given, "base").get("base")
    launch = pick(given, *given)
    require_units(launch, described.units, flag)
    launch = options.SPIN_DEFAULTS | launch
    numbers: Given = {
        name: one_number(name, value, described.units) for name, value in launch.items()
    }
    # A limit mu of zero is one, too.
    present = [name for name, value in numbers.items() if value or name == "mu"]
    refuse_slip_beside(present, "--viscous")
    if drive is not None:
        of_base = columns_of_base(drive, described.units)
        numbers |= {name: float(value) for name, value in of_base.items()}
    values = derived(described, **numbers)
    friction = {quantity.name: quantity.value for quantity in values}["friction"]
    # Sliding friction changes none of these quantities, and a foot that slips under
    # viscous friction needs none.
    mu = numbers.get("mu", COMMON_FRICTION)
    if friction is not None and friction > mu and not numbers.get("viscous"):
        warn(SLIPS_AT_REVERSAL.format(friction))
    if figure is not None:
        from rattlesweep.analysis.onerun.sides import save_figure_of_mesh

        save_figure_of_mesh(figure, of_mesh, {each.name: each for each in values})
    print_result(as_json, _as_data(described, values), _as_table(described, values))
    advice = weights_for_skew(described)
    if advice is not None:
        say(advice.sentence)


def _as_data(body: Rattleback, values: list[DerivedQuantity]) -> dict[str, object]:
    """Return derived quantities by name, and in SI units if the size is known."""
    data: dict[str, object] = {quantity.name: quantity.value for quantity in values}
    if body.units is not None:
        data["units"] = body.units
        data["si"] = {
            quantity.name: {"value": quantity.in_si[0], "unit": quantity.in_si[1]}
            for quantity in values
            if quantity.in_si is not None
        }
    return data


def _as_table(body: Rattleback, values: list[DerivedQuantity]) -> str:
    """Return derived quantities as a text, with SI columns if the size is known."""
    lines = []
    for quantity in values:
        value = "none"
        if quantity.value is not None:
            value = f"{quantity.value:.10g}"
        line = [quantity.name, value, quantity.unit]
        if body.units is not None:
            si = ["", ""]
            if quantity.in_si is not None:
                size, unit = quantity.in_si
                factor, unit = readable_unit(size, unit)
                si = [f"{factor * size:.5g}", unit]
            line += si
        lines.append([*line, quantity.description])
    return align(lines, "<><" if body.units is None else "<><><")


def _list_materials(
    context: click.Context, _: click.Parameter, materials: tuple[object, ...]
) -> tuple[object, ...]:
    """Print all materials and stop if ``list`` is requested."""
    if materials == ("list",):
        from rattlesweep.physics.friction.materials import MATERIALS

        lines = [["", "E, GPa", "nu", ""]]
        for name, each in MATERIALS.items():
            lines.append([name, f"{each.E / 1e9:g}", f"{each.nu:g}", each.source])
        click.echo(align(lines, "<>><"))
        context.exit()
    return materials


@command(
    "One run",
    "rattlesweep contact --half-ellipsoid 12cm,3cm,12mm --mass 60g --skew 3deg "
    "--materials PLA,glass --facet 0.4mm",
    "rattlesweep contact configs/fit/stone.yaml --materials 'E=3.1GPa nu=0.36,wood'",
)
@options.path("stone", required=False)
@option(
    "--materials",
    type=options.MATERIAL_PAIR,
    required=True,
    callback=_list_materials,
    help="Materials of body and plane, as in PLA,glass; each a name or as in "
    "'E=3.5GPa nu=0.36'.  'list' prints all names.",
)
@option("--mu", type=float, default=PATCH_FRICTION, help="Coefficient of friction.")
@option(
    "--n-i",
    type=options.SPIN_VALUE,
    default=PATCH_SPIN,
    help="Vertical spin whose end is told, as in 60rpm.",
)
@option(
    "--facet",
    type=options.HEIGHT,
    help="Width of the flat facets of a printed bottom, to compare with the patch.",
)
@options.body_options
@options.as_json
def contact(stone: Path | None, as_json: bool, **given: Any) -> None:
    """Print the patch of contact under a stone at rest, and the lever of pivoting.

    While a stone spins, this patch rubs on the plane and ends the spin: with a torque
    of the weight times a lever, which dissipation.pivot takes in a config. It also
    gives way, with the friction of dissipation.creep. The patch is Hertz's ellipse, of
    smooth elastic solids: without roughness, wear, yielding, the slow flow of plastics
    or the grain of wood. STONE is a file as for `fit`, of which only the body counts;
    or options describe the body.
    """
    from rattlesweep.api import contact_patch
    from rattlesweep.api.arguments import require_units

    arguments = pick(given, "materials", "mu", "n_i", "facet")
    described = stone_or_options(stone, given)["body"].body
    require_units(arguments, described.units, flag)
    with names_of_options(arguments):
        patch = contact_patch(described, **arguments)
    values = patch.quantities()
    data = _as_data(described, values)
    data |= {"materials": patch.materials, "remarks": patch.remarks}
    print_result(as_json, data, _as_table(described, values))
    for remark in patch.remarks:
        say(remark)


@command(
    "One run",
    "rattlesweep stl --half-ellipsoid 12cm,3cm,12mm --skew 5deg --output stone.stl",
    "rattlesweep stl --half-ellipsoid 12cm,4cm,15mm --at 40mm,-7mm --pocket 10mm,4mm "
    "--output stone.stl",
)
@options.some_of_body("half-ellipsoid", "skew", "at")
@option(
    "--pocket",
    type=options.POCKET_SIZE,
    help="Diameter and depth of a round hole for a weight, around --at; another lies "
    "opposite.",
)
@option(
    "--fineness",
    type=options.COUNT,
    default=FINENESS,
    help="Rings of triangles from the lowest point to the edge.",
)
@options.file(
    "--output",
    *(".stl", ".obj", ".ply", ".3mf"),
    required=True,
    help="File to write, whose unit is mm.",
)
@options.quiet
def stl(output: Path, fineness: int, quiet: bool, **given: Any) -> None:
    """Write a half ellipsoid as a closed mesh for a 3D printer, and read it back.

    A skew turns the base against the flat side: the half ellipsoid is twisted about the
    vertical.  Pockets are left empty in what is read back.
    """
    from math import degrees

    from rattlesweep.physics import si
    from rattlesweep.physics.mesh.printing import told_of_body, write
    from rattlesweep.physics.mesh.shapes import (
        half_ellipsoid_solid,
        pockets_at,
        twist_of,
    )

    probe_files(output)
    if given["half_ellipsoid"] is None:
        raise ConfigError("--half-ellipsoid is missing; add it, as in 12cm,3cm,12mm")
    if (given["at"] is None) != (given["pocket"] is None):
        raise ConfigError("--at and --pocket belong together; give both or none")
    if not LEAST_FINENESS <= fineness <= MOST_FINENESS:
        raise ConfigError(
            f"--fineness: {fineness} is out of range; from {LEAST_FINENESS} to "
            f"{MOST_FINENESS} is allowed"
        )
    names = ("length", "width", "height")
    length, width, height = (
        si.size(text, "length", name)
        for name, text in zip(names, given["half_ellipsoid"], strict=True)
    )
    skew = si.number(given["skew"] or 0.0, "angle", "skew")
    pockets = []
    if given["pocket"] is not None:
        pockets = pockets_at(
            si.two_lengths(given["at"], "at"), si.two_lengths(given["pocket"], "pocket")
        )
    solid = half_ellipsoid_solid(length, width, height, fineness, skew, pockets)
    standing = write(solid, output)
    tell(output)
    if quiet:
        return
    say(
        f"{len(solid.faces):,} triangles, closed, {solid.volume * 1e6:.5g} cm^3, unit "
        f"mm; the base is turned by {degrees(twist_of(skew, length / width)):.4g} deg "
        "against the flat side"
    )
    smaller, larger = standing.surface.radii * 1e3
    found = -degrees(standing.parameters["xi"])
    say(
        f"read back: skew {found:.4g} deg, radii {smaller:.5g} and {larger:.5g} mm, "
        f"centre of mass {standing.height * 1e3:.5g} mm high"
    )
    for line in told_of_body(standing, (length, width, height), skew):
        say(line)
