"""Captures on a bus on which anything may go wrong at any time: drawn by a seed, run, and judged by the registers."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from drivers.emulator.faults import KINDS, Fault, format_fault, parse_fault
from drivers.errors import DriverError
from station.errors import StationError
from station.rig import load_rig
from tests.test_safe_states import Lab, lab

NAMES = ("demo", "openmanipulator_x")
AT_EXIT = ("park-then-release", "hold", "release")
# The motion of the lab begins at once and lasts 8 s; parking may take some seconds more.
BEGINS_S, ENDS_S = 0.3, 11.0
REPLY_TIMEOUT_S = 0.25
PARKED_DEG = 2.5
SETTLES_S = 15.0
# Faults after which a servo is limp that was to hold: it shut itself down, or lost its power.
LIMP = ("alert", "reboot", "voltage", "temperature", "obstruct")


@dataclass(frozen=True)
class Drawn:
    """What is tried: a rig, how its arm is to be left, how long a bus is waited for, and the faults."""

    name: str
    at_exit: str
    reconnect_s: float
    faults: tuple[str, ...]

    def __str__(self) -> str:
        return f"{self.name}, {self.at_exit}, reconnect_s {self.reconnect_s:g}: {' '.join(self.faults)}"


@dataclass
class Verdict:
    """How a capture ended, and what was wrong with that."""

    drawn: Drawn
    ended: str = ""
    left: str = ""
    wrong: list[str] = field(default_factory=list)


def draw(seed: int) -> Drawn:
    """A capture with one to three faults."""
    rng = np.random.default_rng([seed, 6])
    name = NAMES[seed % len(NAMES)]
    ids = [servo.id for joint in load_rig(name).table.joint for servo in joint.servo]
    faults = [_draw_fault(rng, ids) for _ in range(rng.integers(1, 4))]
    reconnect_s = float(rng.choice([0.0, 4.0]))
    return Drawn(name, str(rng.choice(AT_EXIT)), reconnect_s, tuple(format_fault(fault) for fault in faults))


def _draw_fault(rng: np.random.Generator, ids: Sequence[int]) -> Fault:
    kind = str(rng.choice([*KINDS]))
    some = tuple(sorted(int(id) for id in rng.choice(ids, rng.integers(1, 3), replace=False)))
    whom = None if kind in ("unplug", "voltage") or rng.random() < 0.3 else some
    values = {
        "delay": lambda: float(np.round(rng.uniform(0.001, 0.4), 3)),
        "alert": lambda: str(rng.choice(["overload", "overheating", "input_voltage"])),
        "status_level": lambda: float(rng.integers(0, 3)),
        "baud": lambda: 57600.0,
        "voltage": lambda: float(rng.choice([4.0, 9.0, 11.0, 20.0])),
        "temperature": lambda: float(rng.choice([60.0, 73.0, 78.0, 95.0])),
        "obstruct": lambda: float(rng.choice([0.0, 5.0])),
    }
    lasts = kind != "alert" and rng.random() < 0.7
    return Fault(
        kind,
        whom,
        at_s=float(np.round(rng.uniform(BEGINS_S, ENDS_S), 2)),
        for_s=float(np.round(10 ** rng.uniform(-2, 0.7), 3)) if lasts else np.inf,
        rate=float(rng.choice([1.0, 0.3, 0.05])) if kind not in ("alert", "unplug") else 1.0,
        value=values[kind]() if kind in values else None,
    )


def try_out(folder: Path, drawn: Drawn) -> Verdict:
    """Run the capture and judge its end."""
    verdict = Verdict(drawn)
    more = f"reconnect_s = {drawn.reconnect_s:g}"
    faults = '", "'.join(drawn.faults)
    with lab(folder, drawn.name, faults, at_exit=drawn.at_exit, more=more, reply_timeout_s=REPLY_TIMEOUT_S) as bench:
        try:
            bench.capture()
            verdict.ended = "complete"
        except (DriverError, StationError) as error:
            verdict.ended = type(error).__name__
        except BaseException as error:
            verdict.ended = f"{type(error).__name__}: {error}"
            verdict.wrong.append(f"ended with {verdict.ended}")
        state = "complete" if verdict.ended == "complete" else "interrupted"
        if bench.writer.state != state:
            verdict.wrong.append(f"the recording says '{bench.writer.state}', the capture was {state}")
        judge_arm(bench, verdict)
    return verdict


def judge_arm(bench: Lab, verdict: Verdict) -> None:
    """Whether the arm is as the capture says that it left it, and in any case comes to rest."""
    events, drawn = bench.writer.events, verdict.drawn
    left = next((event.partition("arm left: ")[2] for event in events if "arm left: " in event), "")
    verdict.left = left or ("said not to be" if any("leaving the arm" in event for event in events) else "")
    torque = bench.each("torque_enable")
    if left == "as it was found" or left == drawn.at_exit:
        limp = any(fault.startswith(LIMP) for fault in drawn.faults)
        if left == "hold" and not limp and not all(torque):
            verdict.wrong.append(f"left to hold, with torque {torque}")
        if left != "hold" and any(torque):
            verdict.wrong.append(f"left '{left}', with torque {torque}")
        if left == "park-then-release" and abs(bench.joint_deg()) > PARKED_DEG:
            verdict.wrong.append(f"left '{left}' at {bench.joint_deg():.1f} deg")
    elif not verdict.left:
        verdict.wrong.append("nothing is said of how the arm was left")
    elif drawn.at_exit != "hold" and (
        holding := [id for id in _untouched(drawn) if bench.emulated.register(id, "torque_enable")]
    ):
        verdict.wrong.append(f"servos {holding}, which nothing befell, weren't released with the others")
    bench.pass_s(SETTLES_S)
    before = bench.joint_deg()
    bench.pass_s(1.0)
    if abs(bench.joint_deg() - before) > 0.1:
        verdict.wrong.append(f"{SETTLES_S:g} s later the arm still moves")


def _untouched(drawn: Drawn) -> list[int]:
    """Ids of the servos that no fault befalls; none where one befalls all."""
    faults = [parse_fault(fault) for fault in drawn.faults]
    touched = {id for fault in faults for id in fault.servo_ids or ()}
    if any(fault.servo_ids is None for fault in faults):
        return []
    return [servo.id for joint in load_rig(drawn.name).table.joint for servo in joint.servo if servo.id not in touched]


def try_seed(folder: Path, seed: int) -> Verdict:
    """Draw a capture by its seed and try it out."""
    with suppress(FileExistsError):
        folder.mkdir(parents=True)
    return try_out(folder, draw(seed))
