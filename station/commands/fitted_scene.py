"""The scene of a fitted session as a forecast takes it: where the camera saw the root, and the markers on each body."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from station.commands.fitting import joint_types, load_session
from station.compare import Comparison
from station.compare import compare as compare_logs
from station.drawn_scene import exposure, unplaced
from station.errors import InvalidData
from station.fit_files import read_fit
from station.foresight.scene import Link, Mount, Scene
from station.kinematics import se3
from station.kinematics.tree import KinematicTree
from station.logs import FloatArray, JointLog, PoseLog
from station.perception.markers import Marker, cells_along
from station.rig import RigFile
from station.session import FIT_FOLDER

# Frames in which a part was seen together with its body, to know how it sits on it.
LEAST_FRAMES = 5
# Of the poses that are one, the nearer half is believed: a flipped one is far off.
BELIEVED = 0.5
# Metres. A root that strays by more while it is watched doesn't stand still before the camera.
STANDING_M = 0.01


@dataclass(frozen=True, eq=False)
class _Fitted:
    """A tree, the states of its joints, and the poses that it was found in."""

    tree: KinematicTree
    states: JointLog
    poses: PoseLog

    def pose_of(self, part: str) -> FloatArray:
        """(T, 4, 4) of a part in the camera; the camera itself may be one."""
        if part == self.poses.reference:
            return se3.identity(len(self.poses.t_s))
        return self.poses.T_ref_part[:, self.poses.parts.index(part)]

    def relative(self, body: str, part: str) -> FloatArray:
        """(N, 4, 4) pose of a part in a body, from frames that show the body's named part, and else by the joints."""
        direct = _told(se3.inverse(self.pose_of(body)) @ self.pose_of(part))
        if len(direct) >= LEAST_FRAMES:
            return direct
        root = next(r for r in self.tree.tree_roots if body in {r, *(j.child for j in self.tree.outward(r))})
        columns = [self.states.joints.index(column) for column in self.tree.columns]
        q = self.states.q[np.searchsorted(self.states.t_s, self.poses.t_s).clip(0, len(self.states.t_s) - 1)]
        T_root_body = self.tree.forward(q[:, columns], start=root)[body]
        return _told(se3.inverse(self.pose_of(root) @ T_root_body) @ self.pose_of(part))


def fitted_scene(session: Path, rig: RigFile, *, simulate: bool) -> Scene:
    """The mechanism that a session's fit found, before the rig's camera where the session's camera stood.

    Nothing is known of what may hide markers, but for the markers themselves. A joint of the arm is the fitted one of
    its name; joints that nothing drives rest at the middle of what was seen of them.

    Raises:
        StationError: no session, no fit in it, or a fit that has none of the rig's joints.
    """
    loaded, fit = load_session(session), read_fit(session / FIT_FOLDER)
    found = _Fitted(fit.tree, fit.states, loaded.poses)
    recording = loaded.recording
    compared = compare_logs(fit.states, recording.commanded, recording.measured, types=joint_types(fit.tree))
    arm = [joint.name for joint in rig.table.joint]
    links = _links(fit.tree, compared, arm)
    if not links:
        have = ", ".join(joint.name for joint in fit.tree.joints) or "none"
        raise InvalidData(
            f"{session}: the fit has none of the rig's joints ({', '.join(arm)}); it has {have}\n"
            "joints are matched by name: capture with this rig's motions, and fit that"
        )
    placed, standing = _standing(found)
    mounts, lost = _mounts(found, rig, placed)
    exposure_s, notes = exposure(rig.table, simulate=simulate)
    return Scene(
        tree=fit.tree,
        links=links,
        resting={joint.name: _rest(found, joint.columns) for joint in fit.tree.movable if joint.name not in links},
        T_camera_root=placed,
        camera=rig.camera_model,
        exposure_s=exposure_s,
        mounts=mounts,
        blocks=None,
        notes=(
            f"places are those that the fit of {session.name} found; the camera is taken to stand where it stood then",
            "no boxes are known: what hides markers is not foreseen, but for other markers",
            *standing,
            *notes,
            *lost,
            *unplaced(rig.table, {mount.marker_id for mount in mounts}, "the fit"),
        ),
    )


def _links(tree: KinematicTree, compared: Comparison, arm: list[str]) -> dict[str, Link]:
    """Fitted joints with names of the arm's: sign and offset as the session's commands and read-back have them."""
    links = {joint.name: Link() for joint in tree.movable if joint.name in arm and len(joint.columns) == 1}
    for joint in compared.joints:
        against = joint.against_measured or joint.against_commanded
        if joint.fitted_joint in links and joint.joint == joint.fitted_joint and against is not None:
            # The comparison turns it around: the arm's joint is sign times the fitted one, plus the offset.
            links[joint.joint] = Link(joint.sign, -joint.sign * against.offset)
    return links


def _standing(found: _Fitted) -> tuple[dict[str, FloatArray], list[str]]:
    """Where the roots of the trees stand in the camera, and what is doubtful about it."""
    placed: dict[str, FloatArray] = {}
    notes: list[str] = []
    for root in found.tree.tree_roots:
        poses = _told(found.pose_of(root))
        if not len(poses):
            notes.append(f"{root} was never seen: nothing is known of where it and what hangs from it stand")
            continue
        placed[root] = _typical(poses)
        strayed_m = float(np.median(np.linalg.norm(poses[:, :3, 3] - placed[root][:3, 3], axis=-1)))
        if strayed_m > STANDING_M:
            notes.append(f"{root} moved before the camera, by {1e3 * strayed_m:.0f} mm: it is taken to stand still")
        if root != found.tree.root:
            notes.append(f"nothing connects {root} to {found.tree.root}: it is taken to stand where it was seen")
    return placed, notes


def _mounts(found: _Fitted, rig: RigFile, placed: dict[str, FloatArray]) -> tuple[tuple[Mount, ...], list[str]]:
    """The rig's markers on parts that the fit knows, where they sit on their bodies."""
    reached = {body for root in placed for body in (root, *(joint.child for joint in found.tree.outward(root)))}
    cells = cells_along(rig.table.markers.dictionary)
    mounts: list[Mount] = []
    lost: list[str] = []
    for marker in rig.table.marker_table().markers:
        if marker.part not in found.tree.parts or (body := found.tree.body_of(marker.part)) not in reached:
            continue
        relative = found.relative(body, marker.part) if marker.part != body else se3.identity(LEAST_FRAMES)
        if len(relative) < LEAST_FRAMES:
            lost.append(f"{marker.part} was hardly ever seen together with {body}: its place on it is not known")
            continue
        mounts.append(_mount(marker, body, _typical(relative), cells))
    return tuple(mounts), lost


def _mount(marker: Marker, body: str, T_body_part: FloatArray, cells: int) -> Mount:
    # The white rim isn't known; a cell is what markers are printed with.
    return Mount(marker.id, marker.part, body, T_body_part @ marker.mount, marker.size_m, marker.size_m / cells, cells)


def _rest(found: _Fitted, columns: tuple[str, ...]) -> FloatArray:
    """The middle of the states that were seen of a joint."""
    middle = np.array([np.nanmedian(found.states.state(column)) for column in columns])
    return middle if len(columns) > 1 else middle[0]


def _told(T: FloatArray) -> FloatArray:
    """Those of poses (T, 4, 4) that are known."""
    return T[np.all(np.isfinite(T), axis=(-2, -1))]


def _typical(T: FloatArray) -> FloatArray:
    """(4, 4) the mean of those of poses (N, 4, 4) that are nearest to their middle, flipped ones left out."""
    middle = np.median(T[:, :3, 3], axis=0)
    R = se3.project_to_so3(np.median(T[:, :3, :3], axis=0))
    off = np.linalg.norm(T[:, :3, 3] - middle, axis=-1) / STANDING_M + se3.angle(np.swapaxes(R, -1, -2) @ T[:, :3, :3])
    return se3.mean(T[np.argsort(off, kind="stable")[: max(int(BELIEVED * len(T)), 1)]])
