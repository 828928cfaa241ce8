"""Checks of the camera: it opens, keeps its frame rate, and its exposure and stamps can be relied on."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field

from drivers.camera import Camera, Image, Setting, Stamp
from drivers.clock import Clock
from drivers.errors import CameraError, CameraStalled, NoCamera
from station.doctor.finding import Finding, Value, Verdict

WHERE = "camera"
NS = 1_000_000_000
MEASURED_S = 2.0
FIRST_FRAME_S = 5.0  # a webcam may take seconds to give its first frame
# Of the nominal rate. Webcams in dim light drop to half of it or less; jitter over two seconds is far below this.
GOOD_RATE = 0.9
STAMPED: Mapping[Stamp, str] = {
    "arrival": "at arrival, before decoding",
    "driver": "by the camera's driver",
    "file": "by the file",
}
SAID = {NoCamera: "it can't be opened", CameraStalled: "it stopped giving frames"}


@dataclass(frozen=True)
class Watched:
    """What a camera gave.

    Attributes:
        image: the last frame; None if there was none.
        settings: what the camera says of itself.
        stamps: how many frames were stamped how.
    """

    findings: list[Finding]
    image: Image | None
    settings: Mapping[str, Setting] = field(default_factory=dict)
    stamps: Mapping[Stamp, int] = field(default_factory=dict)


def watch_camera(camera: Camera, clock: Clock, *, fps: float) -> Watched:
    """Open a camera, measure its rate over some two seconds, close it."""
    try:
        camera.start()
        return _measured(camera, clock, fps)
    except CameraError as error:
        found = SAID.get(type(error), "it can't be used")
        return Watched([Finding(WHERE, "opens", Verdict.BLOCKS, found, str(error))], None)
    finally:
        camera.close()


def _measured(camera: Camera, clock: Clock, fps: float) -> Watched:
    width, height = camera.size_px
    size = f"{width}x{height} px"
    opened = Finding(WHERE, "opens", Verdict.OK, size, values={"size_px": f"{width}x{height}"}, brief=size)
    frame = camera.read(clock.now_ns() + round(FIRST_FRAME_S * NS))
    if frame is None:
        found, mend = f"no frame in {FIRST_FRAME_S:g} s", "check its cable, and that no other program uses it"
        return Watched([opened, Finding(WHERE, "frame rate", Verdict.BLOCKS, found, mend)], None)
    first_ns, last, frames = frame.t_ns, frame, 0
    stamps: Counter[Stamp] = Counter([frame.stamp])
    end_ns = first_ns + round(MEASURED_S * NS)
    while (frame := camera.read(end_ns)) is not None and frame.t_ns <= end_ns:
        last, frames = frame, frames + 1
        stamps[frame.stamp] += 1
    taken_s = max(last.t_ns - first_ns, 1) / NS
    findings = [opened, _rate(frames, taken_s, fps, camera.dropped), *_stale(camera.stale, frames)]
    return Watched(findings, last.image, camera.settings, stamps)


def _stale(stale: int, frames: int) -> list[Finding]:
    """Whether the camera gives the same picture again."""
    if not stale:
        return []
    found = f"{stale} of {stale + frames} frames were the one before once more"
    mend = "a lower fps, or one that the camera has (v4l2-ctl --list-formats-ext); a camera that freezes is worn out"
    return [Finding(WHERE, "fresh frames", Verdict.WARNING, found, mend, {"stale": stale})]


def _rate(frames: int, taken_s: float, fps: float, dropped: int) -> Finding:
    rate_hz = frames / taken_s if frames else 0.0
    values: dict[str, Value] = {"rate_hz": rate_hz, "nominal_hz": fps, "dropped": dropped}
    said = f"{rate_hz:.1f} frames/s of {fps:g}"
    if rate_hz >= GOOD_RATE * fps:
        return Finding(WHERE, "frame rate", Verdict.OK, said, values=values, brief=said)
    mend = (
        "more light or a fixed exposure (v4l2-ctl -c exposure_dynamic_framerate=0), a USB port of its own, fewer pixels"
    )
    return Finding(WHERE, "frame rate", Verdict.WARNING, said, mend, values)


def check_locks(settings: Mapping[str, Setting], source: int | str) -> list[Finding]:
    """Whether what may not change from frame to frame is locked, as far as the camera tells.

    Args:
        settings: of the started camera.
        source: as the rig gives it.
    """
    findings = [_exposure(settings.get("exposure_locked"), settings.get("exposure_ms"), source)]
    if settings.get("focus_locked") is False:
        found, mend = "automatic: each change is another calibration", "lock it: focus = ... under [camera] in the rig"
        findings.append(Finding(WHERE, "focus", Verdict.WARNING, found, mend, {"focus_locked": False}))
    elif settings.get("focus_locked"):
        said = "focus locked"
        findings.append(Finding(WHERE, "focus", Verdict.OK, "locked", values={"focus_locked": True}, brief=said))
    return findings


def _exposure(locked: Setting, exposure_ms: Setting, source: int | str) -> Finding:
    values: dict[str, Value] = {"exposure_locked": None if locked is None else bool(locked)}
    if locked:
        said = "exposure locked" if exposure_ms is None else f"exposure locked at {exposure_ms:g} ms"
        return Finding(WHERE, "exposure", Verdict.OK, said, values=values, brief="exposure locked")
    device = f"/dev/video{source}" if isinstance(source, int) else source
    lock = f"v4l2-ctl -d {device} -c auto_exposure=1 -c exposure_time_absolute=80   (unit 0.1 ms)"
    older = f"older kernels: v4l2-ctl -d {device} -c exposure_auto=1 -c exposure_absolute=80"
    found = "the camera doesn't tell whether it is locked" if locked is None else "automatic: its time varies"
    mend = f"lock it: exposure_ms = 8 under [camera] in the rig, or {lock}\n{older}"
    if not device.startswith("/dev/"):
        mend = "lock it in the camera's own settings"
    return Finding(WHERE, "exposure", Verdict.WARNING, found, mend, values)


def check_stamps(stamps: Mapping[Stamp, int], latency_s: float) -> Finding:
    """What stamps the frames, and whether the rig says how late they are."""
    by = " and ".join(STAMPED[kind] for kind in stamps)
    values: dict[str, Value] = {"stamps": by, "latency_s": latency_s}
    if len(stamps) > 1:
        counts = ", ".join(f"{count} {STAMPED[kind]}" for kind, count in stamps.items())
        found = f"frames are stamped {counts}: two latencies in one recording"
        mend = "start the camera again; a driver whose stamps can't be believed now and then has none worth using"
        return Finding(WHERE, "stamps", Verdict.WARNING, found, mend, values)
    said = f"stamped {by}, {latency_s * 1e3:g} ms after the exposure"
    if latency_s > 0 or "file" in stamps:
        return Finding(WHERE, "stamps", Verdict.OK, said, values=values, brief="stamped")
    found = f"stamped {by}; the rig gives no latency"
    mend = "set latency_s under [camera] in the rig; the report of a capture says how far the camera trails"
    return Finding(WHERE, "stamps", Verdict.WARNING, found, mend, values)
