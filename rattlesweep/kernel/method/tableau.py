"""Explicit Runge-Kutta methods as data, from which `step.explicit` generates the steps.

NumPy is not imported here, since `--help` and configs need the names of the methods
without it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rattlesweep.arrays import Floats

Row = dict[int, float]

TOL = 1e-9
"""Default error of a step of adaptive methods, relative to the oscillation."""
DT = 0.002
"""Default step of methods with a fixed step, in ``sqrt(a/g)``: the paper's."""
MAX_STEPS = 100_000_000
"""Default number of steps after which a run is given up."""


ROUNDED_SUM = 1e-12  # largest error of a sum of coefficients


@dataclass(frozen=True)
class Tableau:
    """Butcher tableau of an explicit method, which checks itself when it is made.

    Rows hold the non-zero coefficients by index.

    Raises
    ------
    ValueError
        If a row has an impossible index or a wrong sum.
    """

    name: str
    order: int  # of the solution that is propagated
    c: tuple[float, ...]  # nodes: the times of the stages, as fractions of the step
    a: tuple[Row, ...]  # a_ij of each stage i; row 0 is empty
    b: Row  # weights of the solution
    # Weights of the error estimates: no row for a fixed step, one for an embedded pair,
    # two for DOP853.  The index len(a) is that of the derivative at the end of the
    # step.
    errors: tuple[Row, ...]

    def __post_init__(self) -> None:
        if len(self.c) != self.stages:
            raise ValueError(f"{self.name}: {len(self.c)} nodes, {self.stages} stages")
        # The equations do not depend on time, so no kernel would notice a wrong node.
        for i, row in enumerate(self.a):
            self._check(f"row {i} of a", row, i, self.c[i])
        self._check("b", self.b, self.stages, 1.0)
        for i, row in enumerate(self.errors):
            self._check(f"row {i} of errors", row, self.stages + 1, 0.0)

    def _check(self, what: str, row: Row, count: int, total: float) -> None:
        """Raise ValueError unless a row has indices below a count and a sum."""
        if any(not 0 <= j < count for j in row):
            raise ValueError(f"{self.name}, {what}: an index is not below {count}")
        if abs(sum(row.values()) - total) > ROUNDED_SUM:
            raise ValueError(f"{self.name}, {what}: the sum is not {total:g}")

    @property
    def stages(self) -> int:
        """Return the number of stages, without the derivative at the step's end."""
        return len(self.a)

    @property
    def adaptive(self) -> bool:
        """Return whether the method estimates its error."""
        return bool(self.errors)

    def damping(self, z: Floats) -> Floats:
        """Return ``-ln |R(i z)|``: how a step damps an oscillation of ``z`` radians.

        ``R`` is the stability function.  The result is negative where steps amplify.
        """
        import numpy as np

        # R(z) = 1 + sum_k z^k b A^(k-1) 1, a polynomial since the method is explicit.
        weights = np.ones(self.stages)
        value = np.ones(np.shape(z), dtype=complex)
        power = value.copy()
        for _ in range(self.stages):
            power = power * 1j * np.asarray(z)
            value = value + power * sum(b * weights[j] for j, b in self.b.items())
            weights = np.array(
                [sum(a * weights[j] for j, a in row.items()) for row in self.a]
            )
        with np.errstate(divide="ignore"):
            rate: Floats = -np.log(np.abs(value))
        return rate


# Kutta, Z. Math. Phys. 46, 435 (1901)
RK4 = Tableau(
    name="rk4",
    order=4,
    c=(0.0, 1 / 2, 1 / 2, 1.0),
    a=({}, {0: 1 / 2}, {1: 1 / 2}, {2: 1.0}),
    b={0: 1 / 6, 1: 1 / 3, 2: 1 / 3, 3: 1 / 6},
    errors=(),
)

# Dormand and Prince, J. Comput. Appl. Math. 6, 19 (1980)
DOPRI5 = Tableau(
    name="dopri5",
    order=5,
    c=(0.0, 1 / 5, 3 / 10, 4 / 5, 8 / 9, 1.0),
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
        {
            0: 71 / 57600,
            2: -71 / 16695,
            3: 71 / 1920,
            4: -17253 / 339200,
            5: 22 / 525,
            6: -1 / 40,
        },
    ),
)

# fmt: off
# Hairer, Norsett and Wanner, Solving Ordinary Differential Equations I, 2nd ed., II.5;
# dop853.f
DOP853 = Tableau(
    name="dop853",
    order=8,
    c=(0.0, 0.05260015195876773, 0.0789002279381516, 0.1183503419072274,
       0.2816496580927726, 1 / 3, 1 / 4, 4 / 13, 127 / 195, 3 / 5, 6 / 7, 1.0),
    a=(
        {},
        {0: 0.05260015195876773},
        {0: 0.0197250569845379, 1: 0.0591751709536137},
        {0: 0.02958758547680685, 2: 0.08876275643042054},
        {0: 0.2413651341592667, 2: -0.8845494793282861, 3: 0.924834003261792},
        {0: 0.037037037037037035, 3: 0.17082860872947386, 4: 0.12546768756682242},
        {0: 0.037109375, 3: 0.17025221101954405, 4: 0.06021653898045596,
         5: -0.017578125},
        {0: 0.03709200011850479, 3: 0.17038392571223998, 4: 0.10726203044637328,
         5: -0.015319437748624402, 6: 0.008273789163814023},
        {0: 0.6241109587160757, 3: -3.3608926294469414, 4: -0.868219346841726,
         5: 27.59209969944671, 6: 20.154067550477894, 7: -43.48988418106996},
        {0: 0.47766253643826434, 3: -2.4881146199716677, 4: -0.590290826836843,
         5: 21.230051448181193, 6: 15.279233632882423, 7: -33.28821096898486,
         8: -0.020331201708508627},
        {0: -0.9371424300859873, 3: 5.186372428844064, 4: 1.0914373489967295,
         5: -8.149787010746927, 6: -18.52006565999696, 7: 22.739487099350505,
         8: 2.4936055526796523, 9: -3.0467644718982196},
        {0: 2.273310147516538, 3: -10.53449546673725, 4: -2.0008720582248625,
         5: -17.9589318631188, 6: 27.94888452941996, 7: -2.8589982771350235,
         8: -8.87285693353063, 9: 12.360567175794303, 10: 0.6433927460157636},
    ),
    b={0: 0.054293734116568765, 5: 4.450312892752409, 6: 1.8915178993145003,
       7: -5.801203960010585, 8: 0.3111643669578199, 9: -0.1521609496625161,
       10: 0.20136540080403034, 11: 0.04471061572777259},
    errors=(
        {0: 0.01312004499419488, 5: -1.2251564463762044, 6: -0.4957589496572502,
         7: 1.6643771824549864, 8: -0.35032884874997366, 9: 0.3341791187130175,
         10: 0.08192320648511571, 11: -0.022355307863886294},
        {0: -0.18980075407240762, 5: 4.450312892752409, 6: 1.8915178993145003,
         7: -5.801203960010585, 8: -0.4226823213237919, 9: -0.1521609496625161,
         10: 0.20136540080403034, 11: 0.02265179219836082},
    ),
)

# Verner, Numer. Algorithms 53, 383 (2010): the most efficient 9(8) pair
VERNER98 = Tableau(
    name="verner98",
    order=9,
    c=(0.0, 0.03462, 0.09702435063878045, 0.14553652595817068, 0.561,
       0.22900791159048503, 0.544992088409515, 0.645, 0.48375, 0.06757, 0.25,
       0.6590650618730999, 0.8206, 0.9012, 1.0, 1.0),
    a=(
        {},
        {0: 0.03462},
        {0: -0.038933543885728734, 1: 0.13595789452450918},
        {0: 0.03638413148954267, 2: 0.109152394468628},
        {0: 2.02576391439397, 2: -7.638023836496292, 3: 6.173259922102322},
        {0: 0.05112275589406061, 3: 0.17708237945550215, 4: 0.0008027762409222502},
        {0: 0.13160063579752163, 3: -0.29572762526696367, 4: 0.08781378035642952,
         5: 0.6213052975225275},
        {0: 0.07166666666666667, 5: 0.33055335789153195, 6: 0.24277997544180138},
        {0: 0.071806640625, 5: 0.3294380283228177, 6: 0.11651900292718229,
         7: -0.034013671875},
        {0: 0.04836757646340647, 5: 0.03928989925676164, 6: 0.10547409458903446,
         7: -0.021438652846483126, 8: -0.10412291746271944},
        {0: -0.026645614872014785, 5: 0.03333333333333333, 6: -0.1631072244872467,
         7: 0.033960816841277615, 8: 0.1572319413814626, 9: 0.21522674780318796},
        {0: 0.036890092487086225, 5: -0.1465181576725543, 6: 0.22425777681720244,
         7: 0.022944057170660725, 8: -0.003585005290572876, 9: 0.08669223316444385,
         10: 0.43838406519683376},
        {0: -0.48660122151133406, 5: -6.304602650282853, 6: -0.2812456182894726,
         7: -2.6790192362198493, 8: 0.5188156639241576, 9: 1.3653531876033418,
         10: 5.8850910885039465, 11: 2.8028087862720628},
        {0: 0.41853674577534716, 5: 6.724547581906459, 6: -0.4254442801646118,
         7: 3.3432791530012658, 8: 0.6170816631175378, 9: -0.9299661239399328,
         10: -6.099948804751011, 11: -3.002206187889399, 12: 0.2553202529443446},
        {0: -0.7793740861228846, 5: -13.937342538107776, 6: 1.2520488533793572,
         7: -14.69150040801687, 8: -0.4947050585331417, 9: 2.2429749091462368,
         10: 13.367893803828643, 11: 14.396650486650687, 12: -0.79758133317768,
         13: 0.4409353709534278},
        {0: 2.0580513374668863, 5: 22.357937727968032, 6: 0.9094981099755634,
         7: 35.89110098240264, 8: -3.4425150276244536, 9: -4.8654813580363685,
         10: -18.909803813543427, 11: -34.26354448030452, 12: 1.2647565216956427},
    ),
    b={0: 0.014611976858423152, 7: -0.3915211862331339, 8: 0.23109325002895065,
       9: 0.12747667699928525, 10: 0.2246434176204158, 11: 0.5684352689748513,
       12: 0.058258715572158275, 13: 0.13643174034822156, 14: 0.030570139830827976},
    errors=(
        {0: 0.005357988290444578, 7: 2.583020491182464, 8: -0.14252253154686625,
         9: -0.013420653512688676, 10: 0.028672962914094935, 11: -2.624999655215792,
         12: 0.2825509643291537, 13: -0.13643174034822156, 14: -0.030570139830827976,
         15: 0.048342313738239585},
    ),
)
# fmt: on

METHODS: dict[str, Tableau] = {t.name: t for t in (DOP853, DOPRI5, VERNER98, RK4)}
