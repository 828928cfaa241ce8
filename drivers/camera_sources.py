"""Which kind of camera a source is: the one place where that is decided."""

from __future__ import annotations

from pathlib import Path

from drivers.camera import STALL_S, Camera, Controls
from drivers.clock import Clock
from drivers.errors import NoCamera, SettingRefused
from drivers.mjpeg_camera import mjpeg_camera
from drivers.stored_camera import StoredCamera
from drivers.webcam import video_devices, webcam


def is_stored(source: int | str) -> bool:
    """Whether a source is a video file or a folder of images, which wait for their reader."""
    return isinstance(source, str) and (Path(source).is_file() or Path(source).is_dir())


def open_camera(
    source: int | str,
    *,
    size_px: tuple[int, int] | None,
    fps: float | None,
    clock: Clock,
    stall_s: float = STALL_S,
    controls: Controls | None = None,
) -> Camera:
    """The camera for a source, not started yet.

    Args:
        source: index of a camera or such a number as text, path of a device, a video file, a folder of images, or an
            address: http:// and https:// for Motion JPEG, others (rtsp://) through OpenCV.
        size_px: (width, height) to ask for, which the frames must then have; None for as they come.
        fps: frames a second to ask for, or of images, which have no times; None for as it comes.
        clock: gives the stamps; it must run by itself but for stored frames.
        stall_s: without a new frame for so long, a camera has stalled.
        controls: what to lock, and at what.

    Raises:
        NoCamera: there is no such file or device.
        SettingRefused: controls are asked of what has none.
    """
    if isinstance(source, str) and source.isdecimal() and not Path(source).exists():
        source = int(source)
    controls = controls or Controls()
    has_controls = isinstance(source, int) or source.startswith("/dev/")
    if not has_controls and controls != Controls():
        keys = ", ".join(key for key, value in vars(controls).items() if value is not None)
        raise SettingRefused(f"{keys}: only a camera of this machine can be told; leave it out")
    if isinstance(source, str) and source.lower().startswith(("http://", "https://")):
        return mjpeg_camera(source, size_px=size_px, fps=fps, clock=clock, stall_s=stall_s)
    if has_controls or "://" in str(source):
        return webcam(source, size_px=size_px, fps=fps, clock=clock, stall_s=stall_s, controls=controls)
    if not is_stored(source):
        devices = ", ".join(video_devices()) or "no video device"
        raise NoCamera(
            f"camera '{source}': there is no {source}; this machine has {devices}; "
            "give one of these, a video file, a folder of images or an address"
        )
    return StoredCamera(str(source), size_px=size_px, fps=fps, clock=clock)
