"""The drivers' error tree: what went wrong with a servo bus or a camera, and what to do about it."""

from __future__ import annotations


class DriverError(Exception):
    """Root of all errors of the drivers; the message says what, where and what to do next."""


class BusLost(DriverError):
    """The serial port can't be opened, or vanished while in use."""


class NoPort(BusLost):
    """The serial port isn't there, can't be opened, or is held by another program: nothing was sent."""


class ServoError(DriverError):
    """Root of the errors of one servo.

    Attributes:
        servo_id: the servo that was asked.
        joint: the joint that it turns, None where it isn't known.
    """

    def __init__(self, message: str, *, servo_id: int, joint: str | None = None) -> None:
        super().__init__(message)
        self.servo_id = servo_id
        self.joint = joint


class NoReply(ServoError):
    """A servo didn't answer within the deadline, retries included."""


class CorruptReply(ServoError):
    """A servo answered with bytes that are no valid status packet, or not the answer to the question."""


class ServoFault(ServoError):
    """A servo refused an instruction, reports a hardware error, or doesn't keep what was written.

    Attributes:
        flags: the names of the reported error bits, for instance `("overload",)`.
    """

    def __init__(self, message: str, *, servo_id: int, joint: str | None = None, flags: tuple[str, ...] = ()) -> None:
        super().__init__(message, servo_id=servo_id, joint=joint)
        self.flags = flags


class WrongModel(ServoError):
    """The servo with this id is of another model than the configuration says.

    Attributes:
        have: the model number it answered with.
        want: the model number of the configured model.
    """

    def __init__(self, message: str, *, servo_id: int, joint: str | None = None, have: int, want: int) -> None:
        super().__init__(message, servo_id=servo_id, joint=joint)
        self.have = have
        self.want = want


class ArmFault(DriverError):
    """The arm can't do what was asked: a command outside the limits, ganged servos that disagree.

    Attributes:
        joint: the joint at fault, if it is one joint's.
    """

    def __init__(self, message: str, *, joint: str | None = None) -> None:
        super().__init__(message)
        self.joint = joint


class SafetyStop(ArmFault):
    """A joint left the limits of safe use: too hot, too little voltage, too much load, or stalled.

    Attributes:
        what: "temperature", "voltage", "load" or "stall".
    """

    def __init__(self, message: str, *, joint: str, what: str) -> None:
        super().__init__(message, joint=joint)
        self.what = what


class CameraError(DriverError):
    """Root of the cameras' errors."""


class NoCamera(CameraError):
    """The camera or video file isn't there, can't be opened, or refuses the settings."""


class SettingRefused(NoCamera):
    """The camera doesn't keep a setting that was asked for."""


class CameraStalled(CameraError):
    """The camera stopped delivering frames."""


class CameraLost(CameraStalled):
    """The camera vanished: its device is gone, its connection closed."""


class CameraEnded(CameraStalled):
    """There are no more frames: the video or folder was read to its end."""


class NoFrames(NoCamera):
    """What should hold frames is there, and holds none: an empty file, no video, a folder without images."""


class WrongSize(CameraError):
    """A frame has another size than it must have."""


class DamagedFrames(CameraError):
    """Stored frames can't be read from some frame on.

    Attributes:
        frames: how many were read before.
    """

    def __init__(self, message: str, *, frames: int) -> None:
        super().__init__(message)
        self.frames = frames
