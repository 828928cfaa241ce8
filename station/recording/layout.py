"""Names in a recording: timelines, entities, columns and transform frames."""

from __future__ import annotations

APPLICATION = "station"
# The recording's property with its description, and the entity under which rerun keeps it.
PROPERTY = "station"
PROPERTY_ENTITY = "/__properties/station"

# Timelines: time since the session's start; the camera's number of the frame.
ELAPSED = "elapsed"
FRAME = "frame"

# Entities.
COMMANDED = "joints/commanded"
MEASURED = "joints/measured"
SERVOS = "servos"
DETECTED = "joints/detected"
LIVE_STATES = "joints/seen"  # detected while it was recorded, by a tree that was known
OBSERVATIONS = "observations"
IMAGE = "camera/image"
OVERLAY = "camera/image/markers"
LIVE_IMAGE = "camera/image/live"  # of the live view alone: smaller than the camera's
TRANSFORMS = "tf/markers"
MARKERS = "markers"
EVENTS = "log"
AXES = "fit/axes"

# Columns.
SCALARS = "Scalars:scalars"
SERVO_ID = "servo_id"
# A row of servos has all of the first quantity, then all of the next; what the viewer calls them.
SERVO_QUANTITIES = {
    "temperature_c": "temperature (degC)",
    "voltage_v": "voltage (V)",
    "load": "load",
    "speed_rad_s": "speed (rad/s)",
}
REQUEST, REPLY, JOINT_STAMPS = "t_request_ns", "t_reply_ns", "t_joint_ns"
BLOB = "EncodedImage:blob"
STATES_STD, STATES_OF, STATES_UNITS = "std", "columns", "units"
LEVEL, TEXT = "TextLog:level", "TextLog:text"

# Frames of the viewer's transform graph.
CAMERA_FRAME = "camera"
IMAGE_FRAME = "camera_image"
LIVE_IMAGE_FRAME = "camera_image_live"


def marker_frame(marker_id: int) -> str:
    """Name of a marker's frame in the viewer."""
    return f"marker_{marker_id:02d}"
