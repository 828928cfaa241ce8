"""A camera's controls: what is asked of it, locked, and what it says that it has; through OpenCV's V4L2 back end."""

from __future__ import annotations

from typing import Protocol

import cv2

from drivers.camera import Controls, Image, Setting
from drivers.errors import SettingRefused

# linux/v4l2-controls.h, V4L2_CID_EXPOSURE_AUTO: 0 automatic, 1 manual, 2 shutter priority (the time is set),
# 3 aperture priority (the time is automatic). OpenCV's V4L2 back end hands these through.
MANUAL_EXPOSURE = 1
TIME_IS_SET = {0: False, 1: True, 2: True, 3: False}
# V4L2_CID_EXPOSURE_ABSOLUTE counts in 100 us.
EXPOSURE_STEPS_PER_MS = 10.0
# Of the exposure. Sensors count in rows, not in 100 us.
EXPOSURE_SHARE = 0.05
# What the back end gives for a control that the camera hasn't.
NOT_THERE = -1


class Capture(Protocol):
    """What is used of cv2.VideoCapture."""

    def isOpened(self) -> bool: ...

    def set(self, prop: int, value: float, /) -> bool: ...

    def get(self, prop: int, /) -> float: ...

    def grab(self) -> bool: ...

    def retrieve(self) -> tuple[bool, Image]: ...

    def getBackendName(self) -> str: ...

    def release(self) -> None: ...


def set_pixel_format(capture: Capture, pixel_format: str, name: str) -> None:
    """Have the camera send its pixels so; raises SettingRefused. Goes before the size: sizes depend on it."""
    capture.set(cv2.CAP_PROP_FOURCC, cv2.VideoWriter.fourcc(*pixel_format))
    have = _pixel_format(capture)
    if have != pixel_format:
        raise SettingRefused(
            f"{name}: it sends its pixels as {have}; want pixel_format {pixel_format}\n"
            "v4l2-ctl --list-formats-ext shows which formats and sizes it has"
        )


def lock_controls(capture: Capture, controls: Controls, name: str) -> None:
    """Switch automatics off and set the values asked for.

    Raises:
        SettingRefused: the camera hasn't the control, or keeps another value.
    """
    if controls.exposure_ms is not None:
        capture.set(cv2.CAP_PROP_AUTO_EXPOSURE, MANUAL_EXPOSURE)
        steps = max(1.0, round(controls.exposure_ms * EXPOSURE_STEPS_PER_MS))
        _set(capture, cv2.CAP_PROP_EXPOSURE, steps, "exposure_ms", name, 1 + EXPOSURE_SHARE * steps, 1e-1)
        if TIME_IS_SET.get(round(capture.get(cv2.CAP_PROP_AUTO_EXPOSURE))) is False:
            raise SettingRefused(f"{name}: its exposure stays automatic; want exposure_ms = {controls.exposure_ms:g}")
    if controls.gain is not None:
        _set(capture, cv2.CAP_PROP_GAIN, controls.gain, "gain", name)
    if controls.focus is not None:
        _switch_off(capture, cv2.CAP_PROP_AUTOFOCUS, "focus", name)
        _set(capture, cv2.CAP_PROP_FOCUS, controls.focus, "focus", name)
    if controls.white_balance_k is not None:
        _switch_off(capture, cv2.CAP_PROP_AUTO_WB, "white_balance_k", name)
        _set(capture, cv2.CAP_PROP_WB_TEMPERATURE, controls.white_balance_k, "white_balance_k", name)


def read_settings(capture: Capture) -> dict[str, Setting]:
    """What the camera says of its pixels and locks; None where it doesn't tell."""
    exposure = _read(capture, cv2.CAP_PROP_EXPOSURE)
    mode = _read(capture, cv2.CAP_PROP_AUTO_EXPOSURE)
    return {
        "pixel_format": _pixel_format(capture),
        "exposure_ms": None if exposure is None else exposure / EXPOSURE_STEPS_PER_MS,
        "exposure_locked": None if mode is None else TIME_IS_SET.get(round(mode)),
        "focus": _read(capture, cv2.CAP_PROP_FOCUS),
        "focus_locked": _is_off(capture, cv2.CAP_PROP_AUTOFOCUS),
        "gain": _read(capture, cv2.CAP_PROP_GAIN),
        "white_balance_k": _read(capture, cv2.CAP_PROP_WB_TEMPERATURE),
        "white_balance_locked": _is_off(capture, cv2.CAP_PROP_AUTO_WB),
    }


def _pixel_format(capture: Capture) -> str:
    return round(capture.get(cv2.CAP_PROP_FOURCC)).to_bytes(4, "little", signed=False).decode("latin-1")


def _read(capture: Capture, prop: int) -> float | None:
    value = capture.get(prop)
    return None if value == NOT_THERE else value


def _is_off(capture: Capture, prop: int) -> bool | None:
    value = _read(capture, prop)
    return None if value is None else value == 0


def _switch_off(capture: Capture, prop: int, key: str, name: str) -> None:
    """Switch an automatic off; one that isn't there needn't be."""
    capture.set(prop, 0)
    if _is_off(capture, prop) is False:
        raise SettingRefused(f"{name}: what sets its {key} by itself can't be switched off; leave {key} out")


def _set(
    capture: Capture, prop: int, value: float, key: str, name: str, within: float = 0.5, unit: float = 1.0
) -> None:
    capture.set(prop, value)
    have = _read(capture, prop)
    if have is None:
        raise SettingRefused(f"{name}: it has no control for {key}; leave it out of the rig")
    if abs(have - value) > within:
        raise SettingRefused(
            f"{name}: it keeps {key} = {have * unit:g}; want {value * unit:g}\n"
            "v4l2-ctl --list-ctrls shows what it takes"
        )
