"""Logs as MCAP, for Foxglove and its like: JSON messages of Foxglove's own schemas, which those programs know by name.

Topics: `/tf` (foxglove.FrameTransforms: each part in the poses' reference), `/joints/...` (foxglove.JointStates),
`/camera/image` (foxglove.CompressedImage) and `/camera/calibration` (foxglove.CameraCalibration); the tree is attached
as kinematics.urdf and kinematics.json. Times are the log's own seconds. No schema there has covariances or raw corners.
Source: the schemas' pages at docs.foxglove.dev. Needs the package mcap, the extra `mcap`.
"""

from __future__ import annotations

import base64
import json
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any, BinaryIO

import numpy as np

from calibration.intrinsics import CameraModel
from station.errors import InvalidData, StationError
from station.formats.urdf import to_urdf
from station.kinematics import se3
from station.kinematics.tree import KinematicTree
from station.kinematics.tree_json import to_json
from station.logs import JointLog, PoseLog

if TYPE_CHECKING:
    from mcap.writer import Writer

NS_PER_S = 1_000_000_000
CAMERA_FRAME = "camera"

Json = Mapping[str, Any]
# Stamp (ns) and JPEG of each frame.
Images = Iterator[tuple[int, bytes]]

_TIME: Json = {
    "type": "object",
    "title": "time",
    "properties": {"sec": {"type": "integer"}, "nsec": {"type": "integer"}},
}
_TEXT: Json = {"type": "string"}
_NUMBER: Json = {"type": "number"}


def _object(title: str, properties: Json) -> Json:
    return {"title": title, "type": "object", "properties": dict(properties)}


def _list(items: Json) -> Json:
    return {"type": "array", "items": items}


_VECTOR = _object("foxglove.Vector3", dict.fromkeys("xyz", _NUMBER))
_QUATERNION = _object("foxglove.Quaternion", dict.fromkeys("xyzw", _NUMBER))
_TRANSFORM = _object(
    "foxglove.FrameTransform",
    {
        "timestamp": _TIME,
        "parent_frame_id": _TEXT,
        "child_frame_id": _TEXT,
        "translation": _VECTOR,
        "rotation": _QUATERNION,
    },
)
_JOINT = _object("foxglove.JointState", {"name": _TEXT, "position": _NUMBER})
SCHEMAS: Mapping[str, Json] = {
    schema["title"]: schema
    for schema in (
        _object("foxglove.FrameTransforms", {"transforms": _list(_TRANSFORM)}),
        _object("foxglove.JointStates", {"timestamp": _TIME, "joints": _list(_JOINT)}),
        _object(
            "foxglove.CompressedImage",
            {
                "timestamp": _TIME,
                "frame_id": _TEXT,
                "data": {"type": "string", "contentEncoding": "base64"},
                "format": _TEXT,
            },
        ),
        _object(
            "foxglove.CameraCalibration",
            {
                "timestamp": _TIME,
                "frame_id": _TEXT,
                "width": {"type": "integer"},
                "height": {"type": "integer"},
                "distortion_model": _TEXT,
                **{key: _list(_NUMBER) for key in "DKRP"},
            },
        ),
    )
}


class McapLog:
    """Writes logs into one MCAP file; a context, at whose end the file is whole.

    Args:
        file: to write to.

    Raises:
        StationError: the package mcap isn't there.
    """

    def __init__(self, file: BinaryIO) -> None:
        try:
            from mcap.writer import Writer
        except ImportError as error:
            raise StationError(
                "MCAP needs the package mcap, which isn't installed\n"
                "install the station with its extra: pip install 'capture-fit-station[mcap]'"
            ) from error
        self._writer: Writer = Writer(file)
        self._channels: dict[str, int] = {}

    def __enter__(self) -> McapLog:
        self._writer.start(library="station")
        return self

    def __exit__(self, *_: object) -> None:
        self._writer.finish()

    def add_poses(self, log: PoseLog) -> None:
        """Each time's parts in the log's reference, on `/tf`; parts that weren't seen aren't in the message."""
        xyz, wxyz = se3.to_xyz_wxyz(np.where(log.seen[..., None, None], log.T_ref_part, np.eye(4)))
        for t, t_ns in enumerate(_stamps_ns(log.t_s.tolist())):
            transforms = [
                {
                    "timestamp": _time(t_ns),
                    "parent_frame_id": log.reference,
                    "child_frame_id": log.parts[k],
                    "translation": dict(zip("xyz", xyz[t, k].tolist(), strict=True)),
                    "rotation": dict(zip("wxyz", wxyz[t, k].tolist(), strict=True)),
                }
                for k in np.flatnonzero(log.seen[t])
            ]
            self._add("/tf", "foxglove.FrameTransforms", t_ns, {"transforms": transforms})

    def add_states(self, log: JointLog, topic: str) -> None:
        """The joints' states at each time; joints without one aren't in the message."""
        for row, t_ns in enumerate(_stamps_ns(log.t_s.tolist())):
            states = zip(log.joints, log.q[row].tolist(), strict=True)
            joints = [{"name": name, "position": q} for name, q in states if np.isfinite(q)]
            self._add(topic, "foxglove.JointStates", t_ns, {"timestamp": _time(t_ns), "joints": joints})

    def add_images(self, images: Images) -> None:
        """JPEGs, on `/camera/image`."""
        for t_ns, jpeg in images:
            _check_time(t_ns)
            data = base64.b64encode(jpeg).decode("ascii")
            image = {"timestamp": _time(t_ns), "frame_id": CAMERA_FRAME, "data": data, "format": "jpeg"}
            self._add("/camera/image", "foxglove.CompressedImage", t_ns, image)

    def add_camera(self, camera: CameraModel, t_s: float) -> None:
        """The calibration, on `/camera/calibration`, unrectified."""
        (t_ns,) = _stamps_ns([t_s])
        self._add(
            "/camera/calibration",
            "foxglove.CameraCalibration",
            t_ns,
            {
                "timestamp": _time(t_ns),
                "frame_id": CAMERA_FRAME,
                "width": camera.size_px[0],
                "height": camera.size_px[1],
                "distortion_model": "plumb_bob",
                "D": camera.distortion.tolist(),
                "K": camera.matrix.ravel().tolist(),
                "R": np.eye(3).ravel().tolist(),
                "P": np.column_stack([camera.matrix, np.zeros(3)]).ravel().tolist(),
            },
        )

    def attach_tree(self, tree: KinematicTree) -> None:
        """The tree, as URDF and as JSON."""
        for name, media, text in (
            ("kinematics.urdf", "application/xml", to_urdf(tree, "fitted")),
            ("kinematics.json", "application/json", to_json(tree)),
        ):
            self._writer.add_attachment(create_time=0, log_time=0, name=name, media_type=media, data=text.encode())

    def _add(self, topic: str, schema: str, t_ns: int, message: Json) -> None:
        if topic not in self._channels:
            text = json.dumps(SCHEMAS[schema]).encode()
            schema_id = self._writer.register_schema(name=schema, encoding="jsonschema", data=text)
            self._channels[topic] = self._writer.register_channel(
                topic=topic, message_encoding="json", schema_id=schema_id
            )
        data = json.dumps(message, allow_nan=False).encode()
        self._writer.add_message(channel_id=self._channels[topic], log_time=t_ns, publish_time=t_ns, data=data)


def _stamps_ns(t_s: list[float]) -> list[int]:
    stamps_ns = [round(t * NS_PER_S) for t in t_s]
    for t_ns in stamps_ns[:1]:  # they rise
        _check_time(t_ns)
    return stamps_ns


def _check_time(t_ns: int) -> None:
    if t_ns < 0:
        raise InvalidData(f"a time is {t_ns / NS_PER_S:g} s; MCAP has none before 0: choose another format")


def _time(t_ns: int) -> Json:
    return {"sec": t_ns // NS_PER_S, "nsec": t_ns % NS_PER_S}
