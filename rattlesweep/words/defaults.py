"""Defaults that a command and its call in Python share.

This module imports nothing, so that ``--help`` is fast.  Defaults of methods are in
:mod:`rattlesweep.kernel.method.tableau`, those of configs in
:mod:`rattlesweep.config.schema`.
"""

# In sqrt(g/a).
LAUNCH_SPIN = 0.1
LAUNCH_PUSH = 0.01

VERDICT_SPINS = ("30 rpm", "60 rpm", "120 rpm")
VERDICT_PUSH = "6 rpm"
VERDICT_TIME = "20 s"
VERDICT_STONES = 64  # drawn from the errors of what was measured

PATCH_FRICTION = 0.3
PATCH_SPIN = "60 rpm"

FILM_RATE = 120.0  # frames a second
FILM_ERROR = "0.5 deg"  # of its angles

LEAST_ROWS = 2001  # of a time series
ROWS_A_PERIOD = 20  # of the pitch
FRAMES_A_PERIOD = 20  # rows of the page of one run

MESH_UNIT = "mm"
FINENESS = 96  # rings of triangles from the lowest point to the edge
FIGURE_DPI = 150.0  # dots per inch

EXPORT_FORMAT = "mjcf"
CASE_NAME = "rattleback"

SEARCH_SECTION = "omega_y=0+"  # of a run near which orbits are searched
PERIODIC = 'regime == "periodic"'  # runs of a sweep near which orbits are searched
MOST_SEARCHED = 20
BRANCH_STEPS = 100
