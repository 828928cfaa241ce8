"""The Cramer-Rao bound of a rendered log: the drawn mechanism, as the bound of simulated views takes it.

Corners count with the noise that they turn out to have, and only where they were detected; those that something hid
in part don't.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from station.logs import FloatArray
from station.perception.markers import MarkerTable
from station.perception.observations import IntArray, ObservationLog
from station.perception.pose import UNIT_CORNERS
from station.tracking import views_of
from tests.benchmarks.made_joints import MadeJoint, MadeObject
from tests.benchmarks.rendered_truth import CornerNoise, Truth
from tests.fit.image.image_bounds import JointBound, image_bounds
from tests.fit.image.seen_objects import Scene, SeenObject
from tests.fit.image.simulated_views import Seeing, Watched


@dataclass(frozen=True, eq=False)
class _Plates(SeenObject):
    """The plates of a stage: each a part, its corners where its size (M,) [m] puts them."""

    size_m: FloatArray

    @property
    def points_m(self) -> FloatArray:
        return self.size_m[:, None, None] * UNIT_CORNERS


def joint_bounds(
    truth: Truth, observations: ObservationLog, table: MarkerTable, noise: CornerNoise
) -> dict[str, JointBound]:
    """Bounds of the joints by name; of a rolling shutter that of one that sees each frame at its time."""
    views = views_of(observations, table, truth.camera)
    views = replace(views, covariance_px2=noise.measured_px2(observations))
    made, size_m = _made(truth, views.marker_id.astype(np.int64), observations.t_s)
    scene = Scene(joints=len(made.joints), frames=len(views.t_s))
    markers = tuple(range(len(views.marker_id)))
    still = np.tile(np.eye(4), (len(markers), 1, 1))
    root = made.T_ref_root[0]
    seen = _Plates(scene, made.joints, (), root, (), made.body_of, made.T_body_part, markers, still, size_m)
    seeing = Seeing(edge_shift_px=noise.edge_shift_px)
    watched = Watched(seen, seeing, made, truth.camera, views, noise.error_px, noise.hidden, observations, table)
    found = image_bounds(watched).joints
    return dict(zip((joint.name for joint in truth.stage.tree.joints), found, strict=True))


def _made(truth: Truth, marker_id: IntArray, t_s: FloatArray) -> tuple[MadeObject, FloatArray]:
    """The stage at times (T,), its plates in the order of the markers (M,), and their sizes."""
    stage, q = truth.stage, truth.states(t_s)
    bodies = stage.tree.parts
    plates = [stage.plates[p] for p in truth.plate_of(marker_id).tolist()]
    joints = tuple(
        MadeJoint(
            joint.type,
            bodies.index(joint.parent),
            bodies.index(joint.child),
            np.array(joint.axis_parent),
            np.zeros(3) if joint.point_parent_m is None else np.array(joint.point_parent_m),
            np.eye(4),
        )
        for joint in stage.tree.joints
    )
    states = tuple(q[:, [truth.joint(joint.name)]] for joint in stage.tree.joints)
    root = np.tile(stage.T_camera_root, (len(t_s), 1, 1))
    mounts = np.stack([plate.T_body_marker for plate in plates])
    made = MadeObject(joints, states, root, "static", tuple(plate.body for plate in plates), mounts)
    return made, np.array([plate.size_m for plate in plates])
