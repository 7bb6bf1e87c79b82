"""What templates see of a kernel's model: :func:`build.names` binds these names anew for each."""

from __future__ import annotations

from typing import Any

# Numbers of the state and the body's constants; lanes; whether steps have an error control.
N_STATE = N_CONSTANTS = N_PROBE = 0
L = 0
ADAPTIVE = False
# The state that empty lanes are in: some spinning one.
IDLE: Any = (), (), ()

# lane_of(w, l), see lane.py.
lane_of: Any = None

# Functions of :class:`rattlesweep.integrate.model.Model`.
rhs: Any = None
spin: Any = None
spin_rate: Any = None
energy: Any = None
contact: Any = None
error: Any = None
