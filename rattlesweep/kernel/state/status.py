"""How a run ended: integer codes inside the kernels, an enumeration outside."""

from __future__ import annotations

from enum import IntEnum


class Status(IntEnum):
    """The status of a run: its word in tables (``label``) and an explanation."""

    OK = 0, "ok", "integrated to the first reversal or to the horizon"
    NONFINITE = (
        1,
        "nonfinite",
        "the state became infinite or NaN (usually a fixed step too long)",
    )
    STEP_LIMIT = 2, "step_limit", "more steps than integrator.max_steps"
    STEP_TOO_SMALL = (
        3,
        "step_too_small",
        "even the smallest step did not meet the tolerance",
    )
    ENERGY = (
        4,
        "energy",
        "energy was off by more than 1 %: the numbers cannot be trusted",
    )
    NO_HORIZON = 5, "no_horizon", "the horizon in units of t_rGH is not a finite time"
    COARSE = (
        6,
        "coarse_step",
        "the fixed step damped or fed the oscillation by more than 10 %",
    )
    STOPPED = 7, "stopped", "interrupted before the run began or ended; never stored"
    LIMIT = 8, "limit", "the model holds no further; never stored"
    LIFTS_OFF = 9, "lifts_off", "the body leaves the plane"
    JAMMED = (
        10,
        "jammed",
        "rigid bodies under Coulomb's law have no unique motion from here (Painlevé)",
    )
    RIM = 11, "rim", "the contact passes the body's rim, where its surface ends"

    label: str
    meaning: str

    def __new__(cls, value: int, label: str = "", meaning: str = "") -> Status:
        """Create a member with its label and meaning."""
        member = int.__new__(cls, value)
        member._value_ = value
        member.label = label
        member.meaning = meaning
        return member
