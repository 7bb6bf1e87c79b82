"""What a rough look tells of a function within a step."""

from math import cos, pi

import numpy as np
import pytest

from rattlesweep.kernel.look import inside


@pytest.mark.parametrize(("frequency", "longest"), [(1, inside.GLANCED), (2, 2.7)])
def test_a_rough_look_sees_every_dip_of_a_harmonic(frequency, longest):
    """The frequency is in units of the swing, which is the unit of steps, too."""
    may_dip = inside.may_dip.py_func
    for angle in np.linspace(0.05, longest, 60):
        for phase in np.linspace(0, 2 * pi, 120):
            end = phase + frequency * angle
            # It is zero at its least value, if that is between both ends.
            if phase < pi < end or phase < 3 * pi < end:
                values = (1 + cos(x) for x in (phase, (phase + end) / 2, end))
                assert may_dip(*values, angle), (angle, phase)


def test_a_rough_look_leaves_out_what_stays_far_from_zero():
    may_dip = inside.may_dip.py_func
    for angle in np.linspace(0.05, 2, 20):
        for phase in np.linspace(0, 2 * pi, 60):
            points = (phase, phase + angle / 2, phase + angle)
            assert not may_dip(*(3 + cos(x) for x in points), angle)
