"""The units of most commands, as pint reads them.

Pint takes longer to import and to start than the theory of a body takes altogether, so
it is asked only for other units.  A test compares the table with pint, bit for bit.
"""

# Size in SI base units, and these units.
COMMON: dict[str, tuple[float, str]] = {
    "m": (1.0, "meter"),
    "cm": (0.01, "meter"),
    "mm": (0.001, "meter"),
    "um": (1e-06, "meter"),
    "kg": (1.0, "kilogram"),
    "g": (0.001, "kilogram"),
    "mg": (1e-06, "kilogram"),
    "s": (1.0, "second"),
    "ms": (0.001, "second"),
    "rad": (1.0, "radian"),
    "deg": (0.017453292519943295, "radian"),
    "rpm": (0.10471975511965977, "radian / second"),
    "rad/s": (1.0, "radian / second"),
    "Hz": (1.0, "1 / second"),
    "m/s^2": (1.0, "meter / second ** 2"),
    "kg/m^3": (1.0, "kilogram / meter ** 3"),
    "g/cm^3": (999.9999999999999, "kilogram / meter ** 3"),
    "kg m^2": (1.0, "kilogram * meter ** 2"),
    "g cm^2": (1.0000000000000001e-07, "kilogram * meter ** 2"),
    "kg cm^2": (0.0001, "kilogram * meter ** 2"),
    "N m s": (1.0, "kilogram * meter ** 2 / second"),
    "N m s/rad": (1.0, "kilogram * meter ** 2 / radian / second"),
    "J": (1.0, "kilogram * meter ** 2 / second ** 2"),
    "mJ": (0.001, "kilogram * meter ** 2 / second ** 2"),
    "Pa": (1.0, "kilogram / meter / second ** 2"),
}
