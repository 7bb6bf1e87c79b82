#!/usr/bin/env bash
# imufusion 1.3.3 (PyPI; xioTechnologies/Fusion), update_no_magnetometer: the heading of
# a level body that spins about the vertical at one turn a second for 6 s.
#
# Expected: six turns, as the gyroscope tells. Its README says that the start raises the
# gain against the accelerometer for 3 s, which says nothing of heading. We guessed an
# error below one degree.
# Seen (2026-11-29): the heading stays at exactly 0 in the first 3 s. Three turns are
# lost for good, and no message tells. With skip_startup() all six are there. So are
# they if the body rests for 3 s first.
#
# For a stone: it is launched by hand and turns back after 1 to 3 s, so the spin that is
# to be measured is gone, and what is seen begins after the reversal. Integrate the
# gyroscope instead, or begin with rest.
# It fails if that changes. It needs Python 3.11 or later, and writes to a folder that
# it removes.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet imufusion==1.3.3 numpy==2.4.6
"$folder/venv/bin/python" - <<'PYTHON'
from importlib.metadata import version

import imufusion
import numpy as np

RATE, SPIN, SECONDS = 200, 360.0, 6  # rows a second, degrees a second
UP = np.array([0.0, 0.0, 1.0])  # in units of g, as an accelerometer at rest tells


def headings(rest, skip):
    """Return the heading in degrees after each row of the spin, and counted turns."""
    settings = imufusion.AhrsSettings()
    settings.sample_rate = RATE
    settings.gyroscope_range = 2000.0
    reader = imufusion.Ahrs()
    reader.set_settings(settings)
    if skip:
        reader.skip_startup()
    for _ in range(rest * RATE):
        reader.update_no_magnetometer(np.zeros(3), UP)
    halves = []
    for _ in range(SECONDS * RATE):
        reader.update_no_magnetometer(SPIN * UP, UP)
        pose = reader.get_quaternion()
        halves.append(np.arctan2(pose[3], pose[0]))
    return np.degrees(np.unwrap(2 * np.array(halves), period=2 * np.pi))


print("imufusion", version("imufusion"), "| true heading at the end", SPIN * SECONDS)
print("rest before, s | startup skipped | largest heading until 2.9 s | at the end")
for rest, skip, early, end in (
    (0, False, 0.0, 1080.0),
    (0, True, 1044.0, 2160.0),
    (4, False, 1044.0, 2160.0),
):
    heading = headings(rest, skip)
    before = abs(heading[: round(2.9 * RATE)]).max()
    print(f"{rest} | {skip} | {before:.3f} | {heading[-1]:.3f}")
    assert abs(before - early) < 0.5 and abs(heading[-1] - end) < 3
PYTHON
