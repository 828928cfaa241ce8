"""All checks of a rig, from its port to the disk, real or simulated."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path

from calibration.intrinsics import CameraModel
from drivers.camera import Camera
from drivers.camera_sources import is_stored
from drivers.clock import Clock, MonotonicClock, VirtualClock
from drivers.errors import CameraError
from drivers.serial_ports import DEFAULT_LATENCY_MS, User, read_latency_ms
from station.doctor import camera as cameras
from station.doctor.bus import BusReport, Wire, examine_bus
from station.doctor.disk import check_disk
from station.doctor.finding import Finding, Verdict, blocks
from station.doctor.fixes import Change, check_fixes
from station.doctor.port import System, check_port
from station.emulated_arm import EmulatedArm
from station.errors import InvalidFile
from station.formats.rig import EMULATED, RENDERED, RigTable, load_calibration
from station.formats.simulation import SimulationTable
from station.hand_motion import HandMovedObject
from station.perception.jpeg import encode_jpeg
from station.recording.sizes import expected_rates
from station.rig import real_camera, rendered_camera, virtual_reply_timeout_s
from station.rig_reading import read_rig
from station.stage import Stage

NO_ARM = Finding("servos", "answer", Verdict.OK, "the rig has none: what people move is recorded with --hand")
NOT_ASKED = Finding("servos", "answer", Verdict.BLOCKS, "not asked: the port can't be used")


@dataclass(frozen=True)
class Checkup:
    """What was found, and what was changed because it was asked for."""

    rig: str
    findings: tuple[Finding, ...]
    changes: tuple[Change, ...]

    @property
    def passed(self) -> bool:
        """Whether nothing blocks a capture, and all that was asked to be mended is."""
        return not blocks(self.findings) and all(change.done for change in self.changes)

    def as_dict(self) -> dict[str, object]:
        """The checkup for JSON."""
        changes = [vars(change) for change in self.changes]
        findings = [finding.as_dict() for finding in self.findings]
        return {"rig": self.rig, "passed": self.passed, "findings": findings, "changes": changes}


def examine(
    rig: str,
    *,
    simulate: bool = False,
    fixes: Sequence[str] = (),
    folder: Path | None = None,
    system: System | None = None,
    say: Callable[[str], None] = lambda name: None,
) -> Checkup:
    """Check a rig (the name of a packaged one, or a path) before it is used; nothing moves.

    Args:
        simulate: the emulated bus and the rendered camera, whatever the rig names.
        fixes: names of what is to be mended in the servos; nothing else is ever written.
        folder: where sessions would be written; the current one if None.
        system: where the system shows its devices and programs.
        say: is told what is looked at next.

    Raises:
        StationError: the rig can't be read, or a fix isn't known.
    """
    check_fixes(fixes)
    table, _, path = read_rig(rig)
    say("calibration")
    calibration, findings = _calibration(table, path)
    with ExitStack() as stack:
        bench = _Bench(table, rig, simulate, system or System(), stack)
        say("servos")
        port = bench.port_findings()
        # A port that another program uses isn't disturbed.
        report = BusReport([NOT_ASKED]) if blocks(port) else bench.examine_bus(fixes)
        findings += port + report.findings
        say("camera")
        watched = bench.watch(calibration)
    findings += watched.findings
    folder = folder or Path.cwd()
    frame_bytes = None if watched.image is None else len(encode_jpeg(watched.image))
    rates = expected_rates(table, frame_bytes=frame_bytes)
    findings.append(check_disk(folder, shutil.disk_usage(folder).free, rates))
    order = ("port", "servos", "servo", "joint", "camera", "calibration", "disk")
    findings.sort(key=lambda finding: order.index(finding.where.split()[0]))
    return Checkup(str(path), tuple(findings), tuple(report.changes))


class _Bench:
    """The devices of a rig as far as they can be had."""

    def __init__(self, table: RigTable, rig: str, simulate: bool, system: System, stack: ExitStack) -> None:
        self._table, self._rig, self._system = table, rig, system
        self._emulated = table.simulation is not None and (simulate or table.bus.port == EMULATED)
        self._rendered = table.simulation is not None and (simulate or table.camera.source == RENDERED)
        if simulate and table.simulation is None:
            raise InvalidFile(f"{rig} has no [simulation]: it can't run without its hardware")
        virtual = self._rendered and (self._emulated or not table.joint)
        self._clock: Clock = VirtualClock() if virtual else MonotonicClock()
        self._timeout_s = virtual_reply_timeout_s(table.simulation) if virtual else None
        self._arm: EmulatedArm | None = None
        if self._emulated and table.simulation is not None:
            self._arm = EmulatedArm(table, table.simulation, self._clock)
            stack.enter_context(self._arm)
        self._port = table.bus.port if self._arm is None else self._arm.path

    def port_findings(self) -> list[Finding]:
        """Of the port without opening it."""
        if not self._table.joint:
            return []  # the rig of an object that is moved by hand
        if self._emulated:
            return [Finding("port", "exists", Verdict.OK, "emulated", brief="emulated")]
        return check_port(self._port, User.of_this_program(), self._system)

    def examine_bus(self, fixes: Sequence[str]) -> BusReport:
        """Of the servos; the port is opened and closed."""
        if not self._table.joint:
            return BusReport([NO_ARM])
        latency_ms = read_latency_ms(self._port, self._system.sys) or DEFAULT_LATENCY_MS
        wire = Wire(self._port, self._clock, latency_ms / 1000, self._timeout_s)
        return examine_bus(wire, self._table, self._rig, fixes)

    def watch(self, calibration: CameraModel | None) -> cameras.Watched:
        """Of the camera."""
        settings = self._table.camera
        camera, why_not = self._camera(calibration)
        if camera is None:
            return cameras.Watched([why_not], None)
        watched = cameras.watch_camera(camera, self._clock, fps=settings.fps)
        findings = [*watched.findings]
        if watched.image is not None:
            if not self._rendered and not is_stored(settings.source):
                findings += cameras.check_locks(watched.settings, settings.source)
            findings.append(cameras.check_stamps(watched.stamps, settings.latency_s))
        return replace(watched, findings=findings)

    def _camera(self, calibration: CameraModel | None) -> tuple[Camera | None, Finding]:
        table, simulation = self._table, self._table.simulation
        nothing = Finding("camera", "opens", Verdict.BLOCKS, "it isn't rendered without a calibration")
        if not self._rendered or simulation is None:
            try:
                return real_camera(table, self._clock), nothing
            except CameraError as error:
                return None, Finding("camera", "opens", Verdict.BLOCKS, "it can't be opened", str(error))
        if self._arm is None and table.joint:
            mend = 'set port = "emulated", or the source of a real camera'
            return None, Finding("camera", "opens", Verdict.BLOCKS, "a rendered camera can't see a real arm", mend)
        if calibration is None:
            return None, nothing
        return self._rendered_camera(simulation, calibration), nothing

    def _rendered_camera(self, simulation: SimulationTable, calibration: CameraModel) -> Camera:
        stage = Stage(self._table, simulation, calibration, simulation.seed)
        moved = self._arm or HandMovedObject(len(stage.joints), None, self._clock.now_ns())
        virtual = isinstance(self._clock, VirtualClock)
        return rendered_camera(self._table, simulation.camera, stage, moved, self._clock, realtime=not virtual)


def _calibration(table: RigTable, path: Path) -> tuple[CameraModel | None, list[Finding]]:
    """The camera's calibration, and whether it fits the frames."""
    try:
        calibration = load_calibration(table, path.parent, str(path))
    except InvalidFile as error:
        found = "there is none that fits the frames"
        return None, [Finding("calibration", "fits", Verdict.BLOCKS, found, str(error))]
    width, height = calibration.size_px
    said = f"for frames of {width}x{height} px"
    values = {"size_px": f"{width}x{height}", "rms_px": calibration.rms_px}
    return calibration, [Finding("calibration", "fits", Verdict.OK, said, values=values, brief=said)]
