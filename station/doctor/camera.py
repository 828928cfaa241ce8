"""Checks of the camera: it opens, keeps its frame rate, and its exposure and stamps can be relied on."""

from __future__ import annotations

from dataclasses import dataclass

from drivers.camera import Camera, Image
from drivers.clock import Clock
from drivers.errors import CameraError, CameraStalled, NoCamera
from station.doctor.finding import Finding, Value, Verdict

WHERE = "camera"
NS = 1_000_000_000
MEASURED_S = 2.0
FIRST_FRAME_S = 5.0  # a webcam may take seconds to give its first frame
# Of the nominal rate. Webcams in dim light drop to half of it or less; jitter over two seconds is far below this.
GOOD_RATE = 0.9
SAID = {NoCamera: "it can't be opened", CameraStalled: "it stopped giving frames"}


@dataclass(frozen=True)
class Watched:
    """What a camera gave.

    Attributes:
        image: the last frame; None if there was none.
    """

    findings: list[Finding]
    image: Image | None


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
    end_ns = first_ns + round(MEASURED_S * NS)
    while (frame := camera.read(end_ns)) is not None and frame.t_ns <= end_ns:
        last, frames = frame, frames + 1
    taken_s = max(last.t_ns - first_ns, 1) / NS
    return Watched([opened, _rate(frames, taken_s, fps, camera.dropped)], last.image)


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


def check_exposure(locked: bool | None, source: int | str) -> Finding:
    """Whether the exposure is locked; `locked` is None where the camera doesn't tell."""
    values: dict[str, Value] = {"exposure_locked": locked}
    if locked:
        return Finding(WHERE, "exposure", Verdict.OK, "locked", values=values, brief="exposure locked")
    device = f"/dev/video{source}" if isinstance(source, int) else source
    lock = f"v4l2-ctl -d {device} -c auto_exposure=1 -c exposure_time_absolute=80   (unit 0.1 ms)"
    older = f"older kernels: v4l2-ctl -d {device} -c exposure_auto=1 -c exposure_absolute=80"
    found = "the camera doesn't tell whether it is locked" if locked is None else "automatic: its time varies"
    return Finding(WHERE, "exposure", Verdict.WARNING, found, f"lock it: {lock}\n{older}", values)


def check_stamps(source: str, latency_s: float) -> Finding:
    """What stamps the frames, and whether the rig says how late they are."""
    values: dict[str, Value] = {"stamps": source, "latency_s": latency_s}
    said = f"stamped {source}, {latency_s * 1e3:g} ms after the exposure"
    if latency_s > 0:
        return Finding(WHERE, "stamps", Verdict.OK, said, values=values, brief="stamped")
    found = f"stamped {source}; the rig gives no latency"
    mend = "set latency_s under [camera] in the rig; the report of a capture says how far the camera trails"
    return Finding(WHERE, "stamps", Verdict.WARNING, found, mend, values)
