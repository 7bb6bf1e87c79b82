"""Explicit Runge-Kutta methods as data.

A method is a frozen :class:`Tableau` that checks itself when it is made.  The lane
kernel is generated from it (:mod:`rattlesweep.integrate.stages`), and it appears by
its name in the config's choices, the tests and the benchmarks.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

Row = dict[int, float]


@dataclass(frozen=True)
class Tableau:
    """Butcher tableau of an explicit method.

    Parameters
    ----------
    name : str
        Name in configs.
    order : int
        Order of the solution that is carried on.
    a : tuple of dict
        Row ``i`` holds the non-zero ``a_ij`` of stage ``i``; row 0 is empty.
    b : dict
        Non-zero weights of the solution.
    errors : tuple of dict
        Weights of the error estimates: none for a fixed step, one for an embedded pair, two
        for the pair of estimates of DOP853.  Key ``len(a)`` stands for the derivative at
        the end of the step.
    reference : str
        Where the coefficients come from.

    Raises
    ------
    ValueError
        If the rows refer to later stages, if the weights do not sum to 1, or if the weights of
        an error estimate do not sum to 0.
    """

    name: str
    order: int
    a: tuple[Row, ...]
    b: Row
    errors: tuple[Row, ...]
    reference: str

    def __post_init__(self) -> None:
        for i, row in enumerate(self.a):
            if any(not 0 <= j < i for j in row):
                raise ValueError(f"{self.name}: stage {i} is not explicit")
        if abs(math.fsum(self.b.values()) - 1) > 1e-14:
            raise ValueError(f"{self.name}: the weights must sum to 1")
        for row in self.errors:
            if abs(math.fsum(row.values())) > 1e-14:
                raise ValueError(f"{self.name}: the weights of an error must sum to 0")

    @property
    def stages(self) -> int:
        """Number of stages; the derivative at the end of the step comes on top."""
        return len(self.a)

    @property
    def adaptive(self) -> bool:
        """Whether the method estimates its error."""
        return bool(self.errors)

    @cached_property
    def c(self) -> tuple[float, ...]:
        """Nodes: the row sums of ``a``."""
        return tuple(math.fsum(row.values()) for row in self.a)


RK4 = Tableau(
    name="rk4",
    order=4,
    a=({}, {0: 1 / 2}, {1: 1 / 2}, {2: 1.0}),
    b={0: 1 / 6, 1: 1 / 3, 2: 1 / 3, 3: 1 / 6},
    errors=(),
    reference="Kutta (1901)",
)

DOPRI5 = Tableau(
    name="dopri5",
    order=5,
    a=(
        {},
        {0: 1 / 5},
        {0: 3 / 40, 1: 9 / 40},
        {0: 44 / 45, 1: -56 / 15, 2: 32 / 9},
        {0: 19372 / 6561, 1: -25360 / 2187, 2: 64448 / 6561, 3: -212 / 729},
        {0: 9017 / 3168, 1: -355 / 33, 2: 46732 / 5247, 3: 49 / 176, 4: -5103 / 18656},
    ),
    b={0: 35 / 384, 2: 500 / 1113, 3: 125 / 192, 4: -2187 / 6784, 5: 11 / 84},
    errors=(
        {0: 71 / 57600, 2: -71 / 16695, 3: 71 / 1920, 4: -17253 / 339200, 5: 22 / 525, 6: -1 / 40},
    ),
    reference="Dormand and Prince (1980)",
)

DOP853 = Tableau(
    name="dop853",
    order=8,
    a=(
        {},
        {0: 0.05260015195876773},
        {0: 0.0197250569845379, 1: 0.0591751709536137},
        {0: 0.02958758547680685, 2: 0.08876275643042054},
        {0: 0.2413651341592667, 2: -0.8845494793282861, 3: 0.924834003261792},
        {0: 0.037037037037037035, 3: 0.17082860872947386, 4: 0.12546768756682242},
        {0: 0.037109375, 3: 0.17025221101954405, 4: 0.06021653898045596, 5: -0.017578125},
        {
            0: 0.03709200011850479,
            3: 0.17038392571223998,
            4: 0.10726203044637328,
            5: -0.015319437748624402,
            6: 0.008273789163814023,
        },
        {
            0: 0.6241109587160757,
            3: -3.3608926294469414,
            4: -0.868219346841726,
            5: 27.59209969944671,
            6: 20.154067550477894,
            7: -43.48988418106996,
        },
        {
            0: 0.47766253643826434,
            3: -2.4881146199716677,
            4: -0.590290826836843,
            5: 21.230051448181193,
            6: 15.279233632882423,
            7: -33.28821096898486,
            8: -0.020331201708508627,
        },
        {
            0: -0.9371424300859873,
            3: 5.186372428844064,
            4: 1.0914373489967295,
            5: -8.149787010746927,
            6: -18.52006565999696,
            7: 22.739487099350505,
            8: 2.4936055526796523,
            9: -3.0467644718982196,
        },
        {
            0: 2.273310147516538,
            3: -10.53449546673725,
            4: -2.0008720582248625,
            5: -17.9589318631188,
            6: 27.94888452941996,
            7: -2.8589982771350235,
            8: -8.87285693353063,
            9: 12.360567175794303,
            10: 0.6433927460157636,
        },
    ),
    b={
        0: 0.054293734116568765,
        5: 4.450312892752409,
        6: 1.8915178993145003,
        7: -5.801203960010585,
        8: 0.3111643669578199,
        9: -0.1521609496625161,
        10: 0.20136540080403034,
        11: 0.04471061572777259,
    },
    errors=(
        {
            0: 0.01312004499419488,
            5: -1.2251564463762044,
            6: -0.4957589496572502,
            7: 1.6643771824549864,
            8: -0.35032884874997366,
            9: 0.3341791187130175,
            10: 0.08192320648511571,
            11: -0.022355307863886294,
        },
        {
            0: -0.18980075407240762,
            5: 4.450312892752409,
            6: 1.8915178993145003,
            7: -5.801203960010585,
            8: -0.4226823213237919,
            9: -0.1521609496625161,
            10: 0.20136540080403034,
            11: 0.02265179219836082,
        },
    ),
    reference="Hairer, Norsett and Wanner, Solving ODEs I, 2nd ed., II.5 and dop853.f",
)


METHODS: dict[str, Tableau] = {t.name: t for t in (DOP853, DOPRI5, RK4)}
