"""The servo bus of a rig, asked servo by servo: what each tells, and what was mended on request."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field

from drivers.clock import Clock
from drivers.dynamixel import DynamixelBus
from drivers.errors import DriverError
from drivers.joints import JointConfig, ServoConfig
from drivers.probe import Probe
from drivers.scan import ATTEMPTS, PATIENCE, Found, identify
from drivers.servo_settings import LIMITED_MODE, mode_name
from station.doctor.expectation import Expected, expected_servos, rig_setting
from station.doctor.finding import Finding, Verdict
from station.doctor.fixes import STATUS_LEVEL, Change, fix_servo, fix_status_level
from station.doctor.joints import check_joint
from station.doctor.servos import Subject, check_presence, check_servo
from station.formats.rig import RigTable
from station.rig import safety_limits
from station.rig_reading import joint_configs

WHERE = "port"


@dataclass(frozen=True)
class Wire:
    """How to get at the servos.

    Attributes:
        latency_s: of the adapter.
        reply_timeout_s: of the driver; its own if None.
    """

    port: str
    clock: Clock
    latency_s: float
    reply_timeout_s: float | None = None


@dataclass
class BusReport:
    """What is found and changed, as it comes."""

    findings: list[Finding] = field(default_factory=list[Finding])
    changes: list[Change] = field(default_factory=list[Change])


def examine_bus(wire: Wire, table: RigTable, rig: str, fixes: Collection[str] = ()) -> BusReport:
    """Ask all servos of a rig for all that can be asked; what fails at one doesn't keep the others from being asked."""
    report = BusReport()
    expected = expected_servos(table)
    try:
        found = _find_all(wire, table, expected, fixes, report)
        with _driver(wire, table) as bus:
            for want in expected:
                report.findings += check_presence(want, found[want.servo_id], rig)
            for subject in _subjects(bus, table, expected, found):
                report.changes += _fix(subject, fixes)
                report.findings += check_servo(subject)
            for joint in joint_configs(table):
                report.findings += _check_joint(bus, joint, table, found)
    except DriverError as error:  # the port itself: servos that fail are findings
        found = f"the servos couldn't be asked: {type(error).__name__}"
        report.findings.append(Finding(WHERE, "opens", Verdict.BLOCKS, found, str(error)))
    report.findings.sort(key=lambda finding: _place(finding, expected))
    return report


def _driver(wire: Wire, table: RigTable) -> DynamixelBus:
    bus = DynamixelBus(
        wire.port,
        baud=table.bus.baud,
        protocol=table.bus.protocol,
        clock=wire.clock,
        reply_timeout_s=wire.reply_timeout_s,
    )
    for want in expected_servos(table):
        bus.label(want.servo_id, want.joint)
    return bus


def _find_all(
    wire: Wire, table: RigTable, expected: Collection[Expected], fixes: Collection[str], report: BusReport
) -> dict[int, Found | None]:
    """What each servo tells of itself, its status level mended before if that is asked for."""
    found: dict[int, Found | None] = {}
    with Probe(wire.port, rig_setting(table), latency_s=wire.latency_s) as probe:
        for want in expected:
            found[want.servo_id] = here = _find(probe, want.servo_id)
            if here is None or STATUS_LEVEL not in fixes:
                continue
            change = fix_status_level(probe, here, want)
            if change is not None:
                report.changes.append(change)
                found[want.servo_id] = identify(probe, want.servo_id)
    return found


def _find(probe: Probe, servo_id: int) -> Found | None:
    if all(probe.ping(servo_id, patience=PATIENCE).silent for _ in range(ATTEMPTS)):
        return None
    return identify(probe, servo_id)


def _subjects(
    bus: DynamixelBus, table: RigTable, expected: Collection[Expected], found: Mapping[int, Found | None]
) -> list[Subject]:
    """The servos that can be asked for their registers."""
    configs = {servo.id: (joint, servo) for joint in joint_configs(table) for servo in joint.servos}
    subjects: list[Subject] = []
    for want in expected:
        here = found[want.servo_id]
        if here is not None and here.answers_reads and here.model is not None:
            subjects.append(Subject(bus, want, *configs[want.servo_id], here.model, safety_limits(table)))
    return subjects


def _fix(subject: Subject, fixes: Collection[str]) -> list[Change]:
    changes: list[Change] = []
    for name in fixes:
        try:
            change = fix_servo(name, subject)
        except DriverError as error:
            change = Change(subject.expected.where, name, "", None, None, False, str(error))
        if change is not None:
            changes.append(change)
    return changes


def _check_joint(
    bus: DynamixelBus, joint: JointConfig, table: RigTable, found: Mapping[int, Found | None]
) -> list[Finding]:
    counts: dict[int, int] = {}
    limits: dict[int, tuple[int, int]] = {}
    findings: list[Finding] = []
    for servo in joint.servos:
        here = found.get(servo.id)
        if here is None or not here.answers_reads or here.model is None or here.model.name != servo.model:
            continue  # said already; counts of another model mean nothing
        try:
            counts[servo.id] = bus.read(servo.id, "present_position")
            if servo.takes_goals and mode_name(bus, servo.id, servo.table) == LIMITED_MODE:
                limits[servo.id] = _limits(bus, servo)
        except DriverError as error:
            said = f"servo {servo.id} couldn't be asked: {type(error).__name__}"
            findings.append(Finding(f"joint {joint.name}", "position", Verdict.BLOCKS, said, str(error)))
    disagreement_rad = math.radians(table.safety.disagreement_deg)
    return findings + check_joint(joint, counts, limits, disagreement_rad=disagreement_rad)


def _limits(bus: DynamixelBus, servo: ServoConfig) -> tuple[int, int]:
    low, high = servo.table.position_limit_registers
    return bus.read(servo.id, low), bus.read(servo.id, high)


def _place(finding: Finding, expected: Collection[Expected]) -> int:
    """Servos in the rig's order, then the joints; the sort keeps the order of a place's findings."""
    places = [want.where for want in expected]
    if finding.where == WHERE:
        return -1
    return places.index(finding.where) if finding.where in places else len(places)
