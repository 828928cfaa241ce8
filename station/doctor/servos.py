"""Checks of one servo: what it is, how it is fed, and the settings without which the arm can't be driven."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from drivers.dynamixel import DynamixelBus
from drivers.errors import DriverError
from drivers.joints import JointConfig, ServoConfig
from drivers.safety import TEMPERATURE_MARGIN_C, SafetyLimits
from drivers.scan import Found
from drivers.servo_models import ServoModel
from drivers.servo_settings import ALL_STATUS, LIMITED_MODE, POSITION_MODES, following, mode_name
from station.doctor.expectation import Expected
from station.doctor.finding import Finding, Value, Verdict

TIME_BASED, REVERSE = "time_based_profile", "reverse"  # flags of the drive mode
# degC under the limit of a capture: a motion warms a servo by more than that in minutes.
WARM_MARGIN_C = 10.0


@dataclass(frozen=True)
class Subject:
    """A servo that answers, and what the rig says of it."""

    bus: DynamixelBus
    expected: Expected
    joint: JointConfig
    servo: ServoConfig
    model: ServoModel
    safety: SafetyLimits

    def read(self, register: str) -> int:
        """A register's value; raises DriverError."""
        return self.bus.read(self.servo.id, register)

    def read_physical(self, register: str) -> float:
        """A register's value in its SI unit; raises DriverError."""
        return self.model.register(register).physical(self.read(register))

    def finding(
        self,
        check: str,
        verdict: Verdict,
        found: str,
        mend: str = "",
        values: Mapping[str, Value] | None = None,
        brief: str = "",
    ) -> Finding:
        """A finding about this servo."""
        return Finding(self.expected.where, check, verdict, found, mend, values or {}, brief)


def check_presence(expected: Expected, found: Found | None, rig: str) -> list[Finding]:
    """Whether a servo answers, is alone with its id, of the model that the rig names, and answers reads."""
    where = expected.where
    if found is None:
        mend = f"check its power and cable; find it at another baud, id or protocol: station scan --rig {rig}"
        said = f"no reply to {expected.setting}"
        return [Finding(where, "answers", Verdict.BLOCKS, said, mend, {"id": expected.servo_id})]
    findings = [_check_model(expected, found), _check_alone(where, found)]
    if not found.answers_reads:
        found_text = "0: it answers pings alone, so nothing else can be asked"
        mend = "run this again with --fix status-level"
        findings.append(Finding(where, "status return level", Verdict.BLOCKS, found_text, mend, {"level": 0}))
    return findings


def _check_model(expected: Expected, found: Found) -> Finding:
    want = expected.model
    firmware = f"firmware {found.firmware}" if found.firmware is not None else "firmware unknown"
    have = found.model.name if found.model else f"model number {found.model_number}"
    values = {
        "id": found.servo_id,
        "model": have,
        "model_number": found.model_number,
        "expected_model": want.name,
        "expected_model_number": want.model_number,
        "firmware": found.firmware,
    }
    if found.model_number is None:
        mend = "it must answer reads to tell"
        return Finding(expected.where, "model", Verdict.WARNING, "it doesn't tell its model", mend, values)
    if found.model_number == want.model_number:
        brief = f"{want.name} {firmware}"
        return Finding(expected.where, "model", Verdict.OK, brief, values=values, brief=brief)
    said = f"{have} ({found.model_number}), the rig says {want.name} ({want.model_number})"
    mend = "correct 'model' or 'id' of this servo in the rig; nothing is written to it until they agree"
    return Finding(expected.where, "model", Verdict.BLOCKS, said, mend, values)


def _check_alone(where: str, found: Found) -> Finding:
    values = {"asked": found.asked, "damaged_replies": found.damaged, "doubled_replies": found.doubled}
    if not found.shared:
        said = "no sign of another servo with its id"
        return Finding(where, "alone with its id", Verdict.OK, said, values=values)
    said = f"of {found.asked} replies {found.damaged} were damaged, {found.doubled} came twice"
    mend = "two servos have this id, or the cable is bad: plug in one alone, give it another id"
    return Finding(where, "alone with its id", Verdict.BLOCKS, said, mend, values)


def check_servo(subject: Subject) -> list[Finding]:
    """All checks of a servo that answers reads; one that can't be done doesn't keep the others from being."""
    findings: list[Finding] = []
    for name, check in CHECKS.items():
        try:
            finding = check(subject)
        except DriverError as error:
            found = f"couldn't be asked: {type(error).__name__}"
            finding = subject.finding(name, Verdict.BLOCKS, found, str(error))
        if finding is not None:
            findings.append(finding)
    return findings


def _voltage(subject: Subject) -> Finding:
    volts = subject.read_physical(subject.model.voltage_register)
    low, high = subject.safety.min_voltage_v, subject.safety.max_voltage_v
    low = subject.read_physical("min_voltage_limit") if low is None else low
    high = subject.read_physical("max_voltage_limit") if high is None else high
    least, most = subject.model.supply_v
    values = {"voltage_v": volts, "min_voltage_limit_v": low, "max_voltage_limit_v": high}
    said = f"{volts:.1f} V"
    if not low <= volts <= high:
        found = f"{said}; the limits are {low:.1f} to {high:.1f} V"
        return subject.finding("voltage", Verdict.BLOCKS, found, _supply(least, most), values)
    if not least <= volts <= most:
        found = f"{said}; the manual has {least:g} to {most:g} V"
        return subject.finding("voltage", Verdict.WARNING, found, _supply(least, most), values)
    return subject.finding("voltage", Verdict.OK, said, values=values, brief=said)


def _supply(least: float, most: float) -> str:
    return f"supply {least:g} to {most:g} V, by cables short and thick enough that it holds under load"


def _temperature(subject: Subject) -> Finding:
    warm, limit = subject.read_physical("present_temperature"), subject.safety.max_temperature_c
    if limit is None:
        limit = subject.read_physical("temperature_limit") - TEMPERATURE_MARGIN_C
    values = {"temperature_degc": warm, "limit_degc": limit}
    said = f"{warm:.0f} °C"
    if warm < limit - WARM_MARGIN_C:
        return subject.finding("temperature", Verdict.OK, said, values=values, brief=said)
    verdict = Verdict.BLOCKS if warm > limit else Verdict.WARNING
    mend = "let it cool with torque off; relieve the load, lower the speed"
    return subject.finding("temperature", verdict, f"{said}; a capture stops at {limit:.0f} °C", mend, values)


def _alarms(subject: Subject) -> Finding:
    model, register = subject.model, subject.model.hardware_error_register
    if register is not None:
        names = model.error_names(subject.read(register))
    else:
        subject.read("present_temperature")  # any reply tells
        names = subject.bus.alarms.get(subject.servo.id, ())
    values: dict[str, Value] = {"alarms": list(names)}
    if not names:
        return subject.finding("alarms", Verdict.OK, "none", values=values)
    again = "reboot it or " if model.recovery == "reboot" else ""
    mend = f"let it cool, relieve the load, check the supply; then {again}switch it off and on"
    return subject.finding("alarms", Verdict.BLOCKS, ", ".join(names), mend, values)


def _return_delay(subject: Subject) -> Finding:
    delay_us = subject.read_physical("return_delay_time") * 1e6
    values = {"return_delay_us": delay_us}
    said = f"{delay_us:.0f} us"
    if delay_us == 0:
        return subject.finding("return delay", Verdict.OK, said, values=values)
    mend = "each reply is that much later; run this again with --fix return-delay"
    return subject.finding("return delay", Verdict.WARNING, said, mend, values)


def _status_level(subject: Subject) -> Finding:
    level = subject.read("status_return_level")
    values = {"level": level}
    if level == ALL_STATUS:
        return subject.finding("status return level", Verdict.OK, "every instruction is answered", values=values)
    mend = "run this again with --fix status-level"
    found = f"{level}: writes aren't answered"
    return subject.finding("status return level", Verdict.BLOCKS, found, mend, values)


def _operating_mode(subject: Subject) -> Finding:
    name = mode_name(subject.bus, subject.servo.id, subject.model)
    values = {"operating_mode": name}
    said = name.replace("_", " ")
    if name in POSITION_MODES:
        return subject.finding("operating mode", Verdict.OK, said, values=values)
    if subject.model.operating_mode_register is None:
        limits = " and ".join(subject.model.position_limit_registers)
        said, mend = "wheel: both its angle limits are 0", f"set {limits} to the joint's range"
    else:
        mend = "it must be position control: run this again with --fix operating-mode"
    return subject.finding("operating mode", Verdict.BLOCKS, said, mend, values)


def _drive_mode(subject: Subject) -> Finding | None:
    if "drive_mode" not in subject.model.registers:
        return None
    bits = subject.read("drive_mode")
    names = [name for bit, name in subject.model.drive_mode_bits.items() if bits >> bit & 1]
    values: dict[str, Value] = {"drive_mode": bits, "drive_mode_flags": [*names]}
    said = ", ".join(names).replace("_", " ") or "none of its flags is set"
    if TIME_BASED in names:
        mend = "with it profile velocity and acceleration are times: run this again with --fix drive-mode"
        return subject.finding("drive mode", Verdict.BLOCKS, said, mend, values)
    if subject.servo.reversed not in (None, REVERSE in names):
        want = "set" if subject.servo.reversed else "clear"
        mend = f"{want} the reverse bit (0) of its drive mode, or correct 'reversed' in the rig"
        return subject.finding("drive mode", Verdict.BLOCKS, f"{said}; the rig wants reverse {want}", mend, values)
    return subject.finding("drive mode", Verdict.OK, said, values=values)


def _following(subject: Subject) -> Finding:
    complaints = list(following(subject.bus, subject.joint, subject.servo, subject.model))
    leader = subject.joint.servos[0].id
    values: dict[str, Value] = {"ganging": subject.servo.ganging, "leader_id": leader}
    if not complaints:
        said = f"follows servo {leader} by {subject.servo.ganging}" if subject.servo.ganging else "follows none"
        return subject.finding("follows", Verdict.OK, said, values=values)
    found, _, mend = complaints[0].partition("; ")
    return subject.finding("follows", Verdict.BLOCKS, f"it {found}", mend or found, values)


def _position_limits(subject: Subject) -> Finding | None:
    if subject.model.model_number != subject.expected.model.model_number:
        return None  # counts of another model mean nothing
    if not subject.servo.takes_goals or mode_name(subject.bus, subject.servo.id, subject.model) != LIMITED_MODE:
        return None  # no goals are sent to it, or its limits don't bind it
    low, high = (subject.read(name) for name in subject.model.position_limit_registers)
    joint, servo = subject.joint, subject.servo
    want_low, want_high = joint.counts(servo)
    values = {"low_count": low, "high_count": high, "rig_low_count": want_low, "rig_high_count": want_high}
    if low <= want_low and want_high <= high:
        said = f"counts {low} to {high} hold the rig's {want_low} to {want_high}"
        return subject.finding("position limits", Verdict.OK, said, values=values)
    found = f"counts {low} to {high}, the rig's limits need {want_low} to {want_high}"
    mend = "narrow the joint's limits in the rig, or widen the servo's own position limits"
    return subject.finding("position limits", Verdict.BLOCKS, found, mend, values)


CHECKS: dict[str, Callable[[Subject], Finding | None]] = {
    "voltage": _voltage,
    "temperature": _temperature,
    "alarms": _alarms,
    "return delay": _return_delay,
    "status return level": _status_level,
    "operating mode": _operating_mode,
    "drive mode": _drive_mode,
    "follows": _following,
    "position limits": _position_limits,
}
