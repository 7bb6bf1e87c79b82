"""The patch of contact under a body at rest, and the lever of pivoting that follows."""

from __future__ import annotations

from dataclasses import dataclass

from rattlesweep.analysis.derived import DerivedQuantity, quantity_of
from rattlesweep.arrays import with_plain_numbers
from rattlesweep.physics import theory
from rattlesweep.physics.body import Rattleback
from rattlesweep.physics.friction.hertz import Ellipse, ellipse
from rattlesweep.physics.friction.materials import Material, contact_modulus
from rattlesweep.words.quantities import LENGTH, QUANTITIES, RATE, TIME
from rattlesweep.words.units import natural

PRESSURE = "M g / a^2"
_LIMITS = (
    "these are smooth elastic solids at rest: roughness, wear, yielding, the slow flow "
    "of plastics and the grain of wood are left out"
)
# Beyond this share of a radius of curvature, a patch is not small.
MOST_OF_RADIUS = 0.1
# Name, unit and meaning of each number of a patch.
QUANTITIES_OF_PATCH = (
    ("mu", "1", QUANTITIES["mu"].meaning),
    ("modulus", PRESSURE, "contact modulus E* of both materials"),
    ("long_half_axis", LENGTH, "half axis of the patch, along the larger radius"),
    ("short_half_axis", LENGTH, "half axis across it"),
    ("peak_pressure", PRESSURE, "pressure in the middle of the patch"),
    ("approach", LENGTH, "distance by which body and plane approach"),
    ("mean_radius", LENGTH, "mean radius <r>, weighted by the pressure"),
    ("lever", LENGTH, "mu <r>, of the torque against pivoting: pivot"),
    ("n_i", RATE, "initial spin"),
    ("t_spin", TIME, "time in which this torque ends the vertical spin n_i"),
    ("creep", "1", QUANTITIES["creep"].meaning),
    ("K_p_creep", "1", "K_p less what creep takes"),
    ("K_r_creep", "1", "K_r less what creep takes"),
)


@dataclass(frozen=True)
class ContactPatch:
    """Hertz's ellipse of contact under a body at rest, in SI units.

    Stability: stable.

    Attributes
    ----------
    long_half_axis, short_half_axis : float
        Half axes of the ellipse in m; the long one lies along the larger radius.
    peak_pressure : float
        Pressure in the middle in Pa.
    approach : float
        Distance in m by which body and plane approach each other.
    mean_radius : float
        Mean distance <r> from the middle in m, weighted by the pressure.
    lever, pivot : float
        Lever ``mu <r>`` of the torque against pivoting, in m and in units of ``a``.
    t_spin : float
        Time in s in which this torque ends a vertical spin.
    n_i : float
        That spin in ``sqrt(g/a)``.
    mu, creep : float
        Coefficient of friction, with which the patch also gives way as it pivots.
    K_p_creep, K_r_creep : float
        Torque coefficients less what this takes from them.
    modulus : float
        Contact modulus ``E*`` of the materials in Pa.
    materials : tuple of two Material
        Those of body and plane, with ``E`` in Pa and ``nu``.
    body : Rattleback
        The body, whose ``units`` are the SI size of its units.
    remarks : tuple of str
        What the theory leaves out, and doubts whether it applies.
    """

    long_half_axis: float
    short_half_axis: float
    peak_pressure: float
    approach: float
    mean_radius: float
    lever: float
    pivot: float
    t_spin: float
    n_i: float
    mu: float
    K_p_creep: float
    K_r_creep: float
    modulus: float
    materials: tuple[Material, Material]
    body: Rattleback
    remarks: tuple[str, ...]

    def __post_init__(self) -> None:
        with_plain_numbers(self)

    @property
    def creep(self) -> float:
        """The friction with which the patch gives way: `creep` beside `pivot`."""
        return self.mu

    def quantities(self) -> list[DerivedQuantity]:
        """Return the numbers in units of the body and in SI units, with meanings."""
        units = self.body.units
        assert units is not None
        quantities = []
        for name, unit, description in QUANTITIES_OF_PATCH:
            value = getattr(self, name)
            # The others are in SI units.
            if unit != "1" and name != "n_i":
                value /= units.sizes[unit][0]
            quantities.append(quantity_of(self.body, name, value, unit, description))
        return quantities


def patch_under(
    body: Rattleback,
    materials: tuple[Material, Material],
    mu: float,
    n_i: float,
    facet: float | None = None,
) -> ContactPatch:
    """Return the patch of contact under a body with a size.

    `n_i` is in ``sqrt(g/a)``, and `facet` the width of a facet of a print in m.
    """
    units = body.units
    assert units is not None
    radii = (units.length / body.theta, units.length / body.phi)
    modulus = contact_modulus(*materials)
    patch = ellipse(units.mass * units.gravity, radii, modulus)
    pivot = mu * patch.mean_radius / units.length
    remarks = [_LIMITS]
    if facet is not None:
        remarks.append(_compared(patch, facet))
    smaller, larger = radii
    if (
        patch.short_half_axis > MOST_OF_RADIUS * smaller
        or patch.long_half_axis > MOST_OF_RADIUS * larger
    ):
        remarks.append(
            f"the patch is not small against the radii of {smaller:.3g} and "
            f"{larger:.3g} m, as Hertz's theory needs"
        )
    modes = theory.modes(body.alpha, body.beta, body.theta, body.phi, body.xi)
    pitch, roll = theory.creeping_coefficients(body.alpha, body.beta, modes, pivot, mu)
    if roll * modes.K_r < 0:
        whole = abs(float(modes.K_r))
        remarks.append(
            f"creep takes more than the whole K_r of {whole:.3g}, so no steady spin "
            "turns back, however fast it is"
        )
    return ContactPatch(
        **patch._asdict(),
        lever=mu * patch.mean_radius,
        pivot=natural(pivot, "length"),
        # The torque -l N turns a body with the moment of inertia gamma M a^2.
        t_spin=body.gamma * abs(n_i) / pivot * units.time,
        n_i=n_i,
        mu=mu,
        K_p_creep=float(pitch),
        K_r_creep=float(roll),
        modulus=modulus,
        materials=materials,
        body=body,
        remarks=tuple(remarks),
    )


def _compared(patch: Ellipse, facet: float) -> str:
    """Return how a patch compares with the flat facets of a printed bottom."""
    length = 2 * patch.long_half_axis
    width = 2 * patch.short_half_axis
    sizes = f"the patch is {1e3 * length:.3g} mm long and {1e3 * width:.3g} mm wide"
    limit = f"a facet of {1e3 * facet:.3g} mm"
    if facet < width:
        return f"{sizes}, larger than {limit}, so the bottom counts as smooth"
    if facet < length:
        return (
            f"{sizes}, longer but not wider than {limit}: the lever is uncertain; "
            "smooth the bottom, or print it finer"
        )
    return (
        f"{sizes}, not larger than {limit}: the body rests on a flat or an edge, whose "
        "lever this is not; smooth the bottom, or print it finer"
    )
