"""An arm is let go only after a person has been told that it drops."""

from __future__ import annotations

from collections.abc import Callable

from drivers.arm import Arm

Ask = Callable[[str], None]
"""Tells a person something and returns when it may go on; raises if it may not."""


def release(arm: Arm, ask: Ask) -> None:
    """Switch torque off, after it was asked where it is on: what was held drops."""
    if holding := arm.holding():
        ask(f"torque is on ({', '.join(holding)}): it will be switched off, and the arm DROPS. Hold it")
    arm.torque_off()
