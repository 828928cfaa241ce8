"""Fits of sessions and of logs of poses."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from station.compare import compare as compare_logs
from station.errors import InvalidData, InvalidFile, StationError
from station.fit.image.views import COORDINATES, Views
from station.fit.image_checks import ModelChecks, Residuals, checked_residuals
from station.fit.learner import Fit, FitOptions, learn
from station.fit_files import write_fit
from station.formats.camera import parse_camera
from station.formats.markers import parse_markers
from station.formats.read import read_pose_log
from station.formats.rig import parse_rig
from station.kinematics.tree import KinematicTree
from station.logs import FloatArray, PoseLog
from station.session import (
    FIT_FOLDER,
    RECORDING_FILE,
    check_output_folder,
)
from station.smoothing import Smoother, smoother

if TYPE_CHECKING:
    from calibration.intrinsics import CameraModel
    from station.fit.image.image_fit import ImageFit
    from station.perception.markers import MarkerTable
    from station.perception.observations import ObservationLog
    from station.recording import Recording
    from station.tracking import TrackedParts

# Markers of all frames that a fit takes into account. Reading, tracking and learning want some 10 kB of memory for each
# at once, which makes 2 GB; of longer sessions frames are left out, evenly, and it is said.
MOST_MARKERS = 200_000
# A shift of edges is undone in the poses where it is known by more than so many of its deviations, and is above this
# share of the corners' own.
SURE_SIGMAS, MATTERS_SIGMAS = 3.0, 0.5


@dataclass(frozen=True)
class Session:
    """A recorded session as the fit takes it.

    Attributes:
        seen: the markers, at the middle of each frame's exposure.
        table: of the markers.
        camera: that saw them, as it was calibrated.
        readout_s: of its rolling shutter; the calibration's if None.
        tracked: both candidates of every pose, and which was chosen.
        poses: of the tracked parts in the camera.
        viewing: (T, K) rad between the line of sight and the normal of the part's marker; NaN where it was not seen.
    """

    recording: Recording
    seen: ObservationLog
    table: MarkerTable
    camera: CameraModel
    readout_s: float | None
    tracked: TrackedParts
    poses: PoseLog
    viewing: FloatArray

    def views(self) -> Views:
        """The corners, as a fit takes them."""
        from station.tracking import views_of

        return views_of(self.seen, self.table, self.camera, readout_s=self.readout_s)

    def with_edge_shift(self, edge_shift_px: float) -> Session:
        """The same session with poses by corners of which a shift of edges is undone."""
        from station.tracking import reestimate, track_parts

        camera = replace(self.camera, edge_shift_px=edge_shift_px)
        tracked = track_parts(reestimate(self.seen, self.table, camera), self.table, camera, readout_s=self.readout_s)
        return replace(self, tracked=tracked, poses=tracked.poses)


def load_session(path: Path, *, most_markers: int | None = MOST_MARKERS) -> Session:
    """Read a session's recording, and nothing else, and estimate its poses; raises StationError.

    Args:
        most_markers: of all frames; of a session with more, frames are left out evenly, with a notice; all of them
            count if None.
    """
    from station.recording import Recording
    from station.tracking import track_parts, viewing_angles_of_parts

    recording = Recording.load(path, most_markers=most_markers)
    about = recording.description
    rig = None if about.rig is None else parse_rig(about.rig, f"{path}: rig").camera
    latency_s, readout_s = (0.0, None) if rig is None else (rig.latency_s, rig.readout_s)
    seen = replace(recording.observations, t_s=recording.observations.t_s - latency_s)
    markers = parse_markers(about.markers, f"{path}: markers")
    camera = parse_camera(about.camera, f"{path}: camera")
    tracked = track_parts(seen, markers, camera, readout_s=readout_s)
    viewing = viewing_angles_of_parts(seen, markers)
    return Session(recording, seen, markers, camera, readout_s, tracked, tracked.poses, viewing)


def is_session(path: Path) -> bool:
    """Whether a path is a session folder or a recording."""
    return path.suffix == ".rrd" or (path / RECORDING_FILE).exists()


@dataclass(frozen=True)
class FitResult:
    """What a fit found and where it was written; `checks` of a tree that was refined on corners."""

    folder: Path
    fit: Fit
    notices: tuple[str, ...] = ()
    checks: ModelChecks | None = None


def fit(
    source: Path,
    out: Path | None = None,
    *,
    options: FitOptions | None = None,
    smooth: str | None = None,
    force: bool = False,
) -> FitResult:
    """Discover the kinematic tree in a session, or in a log of poses, and write it.

    Writes kinematics.json, joint_states.csv, kinematics.urdf and a drawing of tree and states; for a tree refined on
    corners residuals.parquet, what is left of them, tested for what the model doesn't know of; for a session also
    fit.rrd, which the viewer shows together with the recording. The joints of a session with commands are named by the
    commanded joint that they follow.

    A session's tree is refined on the corners of its markers, and its joint states come from them, unless the options
    say otherwise. Where the corners then show that all edges are seen shifted by more than the calibration says, which
    fools poses, the poses are made anew without the shift, and the tree is found again.

    Args:
        source: a session folder, a recording, or a pose log in any format that is read.
        out: new or empty folder; for a session its own fit/ if None.
        options: how to fit.
        smooth: a smoother of the poses, see `station.smoothing.smoother`; it correlates the noise of neighbouring
            frames, which the fit takes for independent, so that what it states of its certainty is too good. It
            smoothes no corners: a session's tree is then refined on its poses.
        force: overwrite an earlier fit in `out`.

    Raises:
        StationError: the input can't be read or has nothing to fit; `out` is occupied; there is no such smoother; a
            log of poses, or smoothed ones, are to be refined on corners.
    """
    smoothed = smoother(smooth) if smooth else None
    options = options or FitOptions()
    if smoothed is not None and options.refine == "image":
        raise StationError(
            "smoothing is of poses, and a tree refined on the image is fitted to the corners as they are\n"
            "leave out --smooth, or refine on the poses: --refine pose"
        )
    if not source.exists():
        raise InvalidFile(f"no input '{source}'; want a session folder, a recording.rrd or a log of poses")
    session = load_session(source) if is_session(source) else None
    if out is None:
        if session is None or not source.is_dir():
            raise StationError(f"'{source}' is no session folder: name a folder for the result with --out")
        out = source / FIT_FOLDER
    check_output_folder(out, force=force)
    if session is None and options.refine == "image":
        raise InvalidData(
            f"{source} is a log of poses, which has no corners to refine the tree on\n"
            "want a session, whose recording has them, or refine on the poses: --refine pose"
        )
    try:
        found = _of_poses(source, options, smoothed) if session is None else discover(session, options, smoothed)
    except InvalidData as error:
        raise InvalidData(f"{source}: {error}") from error
    found, residuals = _checked(found)
    write_fit(found.fit, out, residuals=residuals, force=force)
    if session is not None and out == source / FIT_FOLDER:
        from station.recording import append_detected

        append_detected(source, found.fit.states, found.fit.tree, found.poses)
    return FitResult(out, found.fit, found.notices, None if residuals is None else residuals.checks)


@dataclass(frozen=True, eq=False)
class Discovery:
    """A fit, the poses that it is of, and what is to be said of them."""

    fit: Fit
    poses: PoseLog
    notices: tuple[str, ...] = ()


def _checked(found: Discovery) -> tuple[Discovery, Residuals | None]:
    """A fit with a warning for each thing that its model doesn't know of, and what it leaves of the corners, if any."""
    if found.fit.image is None:
        return found, None
    residuals = checked_residuals(found.fit.tree, found.fit.image)
    warnings = (*found.fit.tree.warnings, *(finding.text for finding in residuals.checks.findings))
    return replace(found, fit=replace(found.fit, tree=replace(found.fit.tree, warnings=warnings))), residuals


def _of_poses(source: Path, options: FitOptions, smoothed: Smoother | None) -> Discovery:
    poses = read_pose_log(source)
    poses = poses if smoothed is None else smoothed(poses)
    return Discovery(learn(poses, options), poses)


def discover(session: Session, options: FitOptions, smoothed: Smoother | None = None) -> Discovery:
    """The tree of a session, and its joints' states; see `fit`, which writes them."""
    by_image = options.method == "station" and options.refine in ("image", None) and smoothed is None
    views = session.views() if by_image else None
    found = _learned(session, options, smoothed, views)
    if found.fit.image is not None and (shift_px := _unknown_shift_px(found.fit.image)) is not None:
        again = _learned(session.with_edge_shift(shift_px), options, smoothed, views)
        said = f"edges are seen {shift_px:.3f} px outward; poses were made anew without that, and the tree of them"
        found = replace(found, notices=(said, *again.notices))
    notices = (*session.recording.notices, *found.notices)
    return replace(found, fit=_named_by_commands(found.fit, session.recording), notices=notices)


def _learned(session: Session, options: FitOptions, smoothed: Smoother | None, views: Views | None) -> Discovery:
    """A session's fit; where poses are ambiguous they are first chosen by what they alone tell of the tree."""
    as_they_are = session.poses if smoothed is None else smoothed(session.poses)
    if not session.tracked.choice.ambiguous.any():
        return Discovery(learn(as_they_are, options, views), as_they_are)
    by_poses = learn(as_they_are, options if views is None else replace(options, refine="pose"))
    turned = _chosen_by_tree(session, by_poses.tree)
    if turned is None and views is None:
        return Discovery(by_poses, as_they_are)
    poses, notices = (as_they_are, ()) if turned is None else (turned[0], (turned[1],))
    if turned is not None and smoothed is not None:
        poses = smoothed(poses)
    return Discovery(learn(poses, options, views), poses, notices)


def _unknown_shift_px(image: ImageFit) -> float | None:
    """The shift of edges that corners tell, where the poses that were made without it are worse for it; else None."""
    shift_px = image.numbers.edge_shift_px
    off_px, std_px = abs(shift_px - (image.views.camera.edge_shift_px or 0.0)), image.numbers_std.edge_shift_px
    variance_px2 = np.trace(image.views.covariance_px2, axis1=1, axis2=2) / COORDINATES
    noise_px = np.median(np.sqrt(variance_px2) * image.scale[image.views.marker])
    sure, matters = off_px > SURE_SIGMAS * std_px, off_px > MATTERS_SIGMAS * noise_px
    return shift_px if sure and matters else None


def _chosen_by_tree(session: Session, tree: KinematicTree) -> tuple[PoseLog, str] | None:
    """The poses with ambiguous ones turned as the tree says, and how many; None if it turns none."""
    from station.kinematic_choice import choose_by_tree

    choice = choose_by_tree(session.tracked, tree)
    turned = int(np.count_nonzero(choice.chosen != session.tracked.choice.chosen))
    if not turned:
        return None
    poses = replace(session.tracked, choice=choice).poses
    return poses, f"{turned} ambiguous poses of markers seen from the front were turned over to agree with the tree"


def _named_by_commands(found: Fit, recording: Recording) -> Fit:
    """The same fit, its joints named by the commanded joints that they follow, and turned to increase with them."""
    matched = compare_logs(found.states, recording.commanded, recording.measured, types=joint_types(found.tree))
    names = {joint.fitted_joint: joint.joint for joint in matched.joints}
    signs = {joint.fitted_joint: joint.sign for joint in matched.joints}
    joints = tuple(
        replace(joint.with_sign(signs.get(joint.name, 1)), name=names.get(joint.name, joint.name))
        for joint in found.tree.joints
    )
    states = replace(
        found.states,
        joints=tuple(column for joint in joints for column in joint.columns),
        q=found.states.q * np.array([signs.get(name, 1) for name in found.states.joints]),
    )
    return replace(found, tree=replace(found.tree, joints=joints), states=states)


def joint_types(tree: KinematicTree) -> dict[str, str]:
    """Type of the joint that each column of joint states belongs to."""
    return {column: joint.type for joint in tree.joints for column in joint.columns}
