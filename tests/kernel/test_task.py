"""Calls in their own threads: their results, their errors, and how they are stopped."""

import os
import signal
import threading
import time
from collections.abc import Callable

import pytest

from rattlesweep.kernel.task import PATIENCE, Control, Task, side_by_side


def until_stopped(control: Control) -> str:
    while not control.flag[0]:
        time.sleep(0.01)
    return "stopped"


def test_ctrl_c_leaves_a_task_its_time_to_hand_over():
    def call(control: Control) -> str:
        until_stopped(control)
        time.sleep(1.2 * PATIENCE)
        return "rest"

    at_work = Task(call)
    threading.Timer(0.05, os.kill, (os.getpid(), signal.SIGINT)).start()
    with pytest.raises(KeyboardInterrupt):
        at_work.wait()
    with pytest.raises(TimeoutError):
        at_work.value()
    at_work.stop(30)
    assert at_work.value() == "rest"


def test_calls_side_by_side_keep_their_order():
    def call(k: int) -> Callable[[Control], int]:
        return lambda control: time.sleep(0.01 * (5 - k)) or k

    assert side_by_side([call(k) for k in range(5)], 3) == list(range(5))
    assert side_by_side([], 3) == []


def test_the_first_error_stops_the_other_calls_and_is_raised():
    others = []

    def fail(control: Control) -> None:
        raise ArithmeticError("no step")

    def call(control: Control) -> None:
        others.append(until_stopped(control))
        raise ValueError("because it was stopped")

    with pytest.raises(ArithmeticError, match="no step"):
        side_by_side([call, fail, *[call] * 200], 2)
    assert others == ["stopped"]
