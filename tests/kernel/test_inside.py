"""What a rough look tells of a function within a step."""

from math import ceil, cos, inf, pi

import numpy as np
import pandas as pd
import pytest

import rattlesweep as rs
from rattlesweep.kernel.look import inside
from rattlesweep.kernel.mode import pivots


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


@pytest.mark.parametrize("frequency", [0.5, 1, 2])
def test_a_followed_harmonic_falls_no_further_between_looks(frequency):
    """The looks and the bound are those of `pivots.may_fall_within`."""
    followed = pivots.followed.py_func
    for angle in np.linspace(inside.GLANCED, 9, 20):
        pieces = ceil(angle / inside.SPACING)
        for phase in np.linspace(0, 2 * pi, 60):
            seen = inf, -inf, 0.0, 0.0, 0.0
            for k in range(pieces + 1):
                value = cos(phase + frequency * angle * k / pieces)
                seen = followed(seen, value, k)
            low, top, bend, _, _ = seen
            dense = np.cos(phase + frequency * np.linspace(0, angle, 2000))
            share = inside.FOLLOWED + inside.INTERPOLATED * inside.GLANCED**6
            assert low - share * (top - low) - 0.125 * bend <= dense.min()
            # Nor is it of much use to search what is this far from zero.
            assert low - share * (top - low) - 0.125 * bend > dense.min() - 0.3


@pytest.mark.parametrize("word", ["late", "casimir", "reversals", "windows", "t_half"])
def test_a_recorded_contact_changes_no_other_column(word):
    # Searches for extremes of the contact are made when a run has ended.
    launches = {"n_i": np.linspace(-0.5, 0.5, 24), "omega_xy0": 0.05, "t_end": 100.0}
    alone = rs.simulate(rs.Rattleback.gh(), record=[word], **launches)
    both = rs.simulate(rs.Rattleback.gh(), record=["contact", word], **launches)
    assert set(both.columns) - set(alone.columns) >= {"contact_ratio_max"}
    pd.testing.assert_frame_equal(both[alone.columns], alone, check_exact=True)
