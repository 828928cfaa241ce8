"""Whatever is done to an emulated servo of any model: it refuses or obeys, keeps its bounds, and minds no reader."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.emulator import EmulatedServo
from drivers.emulator.servo import Refused
from drivers.servo_models import MODELS, load_model
from tests.drivers.servo_access import MS, S, read, write

Act = Callable[[EmulatedServo, int], object]


@dataclass(frozen=True)
class Step:
    """Something that is done to a servo, some time after the step before."""

    wait_ns: int
    name: str
    act: Act

    def __repr__(self) -> str:
        return f"{self.wait_ns} ns, {self.name}"


def swinging(t_ns: int) -> float:
    return 0.7 * math.sin(t_ns * 3e-9)


LIVES = [{}, {"load_nm": swinging, "backlash_rad": 0.01}]


@st.composite
def steps(draw: st.DrawFn, model: str) -> Step:
    wait_ns = draw(st.integers(0, 400 * MS))
    registers = [register for register in load_model(model).registers.values() if register.writable]
    kind = draw(
        st.sampled_from(["write"] * 8 + ["goal", "goal", "torque", "torque", "bytes", "hear", "world", "start"])
    )
    match kind:
        case "write" | "goal" | "torque":
            wanted = {"goal": "goal_position", "torque": "torque_enable"}.get(kind)
            register = load_model(model).register(wanted) if wanted else draw(st.sampled_from(registers))
            low, high = register.span
            if register.minimum is not None and register.maximum is not None and draw(st.integers(0, 9)):
                low, high = register.minimum, register.maximum
            if kind == "goal":
                low, high = 0, load_model(model).resolution - 1
            value = 1 if kind == "torque" and draw(st.integers(0, 3)) else draw(st.integers(low, high))
            return Step(wait_ns, f"{register.name} = {value}", lambda servo, t: write(servo, register.name, value, t))
        case "bytes":
            address, data = draw(st.integers(0, 700)), draw(st.binary(min_size=0, max_size=12))
            if draw(st.booleans()):
                return Step(wait_ns, f"{address}: {data!r}", lambda servo, t: servo.write(address, data, t))
            return Step(wait_ns, f"later {address}: {data!r}", lambda servo, t: servo.register_write(address, data))
        case "hear":
            return Step(wait_ns, "hear", lambda servo, t: servo.hear(t))
        case "world":
            return draw(worlds(wait_ns))
    restarts: dict[str, Act] = {
        "action": lambda servo, t: servo.action(t),
        "reboot": lambda servo, t: servo.reboot(t),
        "factory reset": lambda servo, t: servo.factory_reset(t, keep=("id",)),
    }
    name = draw(st.sampled_from(sorted(restarts)))
    return Step(wait_ns, name, restarts[name])


@st.composite
def worlds(draw: st.DrawFn, wait_ns: int) -> Step:
    """What happens to a servo from outside, now or a little later."""
    later = draw(st.sampled_from([0, 0, 130 * MS]))
    match draw(st.sampled_from(["voltage", "temperature", "obstruct"])):
        case "voltage":
            volt = draw(st.floats(3.0, 30.0))
            return Step(wait_ns, f"{volt} V", lambda servo, t: servo.set_voltage(volt, t + later))
        case "temperature":
            celsius = draw(st.floats(0.0, 110.0))
            return Step(wait_ns, f"{celsius} C", lambda servo, t: servo.set_temperature(celsius, t + later))
        case _:
            lower, upper = draw(st.floats(-2.0, 0.0)), draw(st.floats(0.0, 2.0))
            return Step(wait_ns, f"{lower} to {upper}", lambda servo, t: servo.obstruct(lower, upper, t + later))


def live(servo: EmulatedServo, life: list[Step], between: Callable[[EmulatedServo, int, int], None]) -> list[bool]:
    """Do all steps; whether each was obeyed. `between` is called with the times of two steps."""
    t_ns, obeyed = 0, list[bool]()
    servo.advance(0)
    for step in life:
        between(servo, t_ns, t_ns + step.wait_ns)
        t_ns += step.wait_ns
        try:
            step.act(servo, t_ns)
            obeyed.append(True)
        except Refused:
            obeyed.append(False)
    between(servo, t_ns, t_ns + 2 * S)
    servo.advance(t_ns + 2 * S)
    return obeyed


def unasked(servo: EmulatedServo, start_ns: int, end_ns: int) -> None:
    """Nobody reads."""


@pytest.mark.parametrize("model", MODELS)
@given(data=st.data())
@settings(max_examples=12, deadline=None)
def test_readers_change_nothing_and_only_refusals_are_raised(model: str, data: st.DataObject) -> None:
    life = data.draw(st.lists(steps(model), max_size=25))
    reads = data.draw(st.lists(st.tuples(st.floats(0, 1), st.integers(0, 700), st.integers(0, 200)), max_size=4))

    def ask(servo: EmulatedServo, start_ns: int, end_ns: int) -> None:
        for part, address, length in sorted(reads):
            t_ns = start_ns + round((end_ns - start_ns) * part)
            servo.shaft_rad(t_ns)
            try:
                servo.read(address, length, t_ns)
            except Refused:
                assert length < 1 or address + length > servo.model.size_bytes

    for around in LIVES:
        alone, asked = (EmulatedServo(1, model, **around) for _ in range(2))
        assert live(alone, life, unasked) == live(asked, life, ask)
        end_ns = sum(step.wait_ns for step in life) + 2 * S
        assert alone.shaft.at(end_ns) == asked.shaft.at(end_ns)
        size = alone.model.size_bytes
        assert alone.read(0, size, end_ns) == asked.read(0, size, end_ns)


@pytest.mark.parametrize("model", MODELS)
@given(data=st.data())
@settings(max_examples=6, deadline=None)
def test_the_shaft_stays_within_obstructions_and_never_jumps(model: str, data: st.DataObject) -> None:
    life = data.draw(st.lists(steps(model), max_size=15))
    lower, upper = data.draw(st.floats(-2.0, 0.0)), data.draw(st.floats(0.0, 2.0))
    for around in LIVES:
        servo = EmulatedServo(1, model, **around)
        servo.obstruct(lower, upper, 0)
        # the motor's own speed, what the load adds, and the same again through the play
        fastest = (2 + 0.7 / servo.model.stall_nm) * servo.model.no_load_rad_s * 1.01

        def look(servo: EmulatedServo, start_ns: int, end_ns: int, fastest: float = fastest) -> None:
            times = [start_ns + (end_ns - start_ns) * k // 8 for k in range(9)]
            rad = [servo.shaft_rad(t_ns) for t_ns in times]
            assert lower <= min(rad) <= max(rad) <= upper
            for k in range(8):
                assert abs(rad[k + 1] - rad[k]) <= fastest * (times[k + 1] - times[k]) * 1e-9 + 1e-6

        live(servo, [step for step in life if " to " not in step.name], look)


@pytest.mark.parametrize("model", MODELS)
@given(data=st.data())
@settings(max_examples=10, deadline=None)
def test_present_position_is_the_shafts_nearest_count(model: str, data: st.DataObject) -> None:
    loaded = data.draw(st.booleans())  # by less than turns any model back
    load_nm, backlash_rad = (lambda t_ns: swinging(t_ns) / 10, 0.01) if loaded else (None, 0.0)
    servo = EmulatedServo(1, model, load_nm=load_nm, backlash_rad=backlash_rad)
    last = servo.model.resolution - 1
    write(servo, "torque_enable", 1, 0)
    t_ns = 0
    for goal, wait_ns in data.draw(st.lists(st.tuples(st.integers(200, last - 200), st.integers(0, S)), max_size=6)):
        write(servo, "goal_position", goal, t_ns)
        t_ns += wait_ns
        count = servo.model.zero_count + servo.shaft_rad(t_ns) / servo.model.rad_per_count
        # half a count, and what float64 makes of one
        assert abs(read(servo, "present_position", t_ns) - min(max(count, 0), last)) <= 0.5 + 1e-9
