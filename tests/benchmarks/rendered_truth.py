"""The truth behind rendered pictures: where each corner was, and so how noisy the detected ones are."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from calibration.intrinsics import CameraModel, project
from station.fit.result import Fit
from station.logs import BoolArray, FloatArray
from station.perception.corner_noise import chi2_quantile, total_covariance
from station.perception.markers import MarkerTable
from station.perception.observations import COORDINATES, IntArray, ObservationLog
from station.perception.pose import UNIT_CORNERS
from station.perception.rolling_shutter import row_delay_s
from station.quadrilaterals import edge_shift_jacobian
from station.stage import Stage


@dataclass(frozen=True, eq=False)
class Truth:
    """What a rendered camera looked at.

    Attributes:
        stage: the true mechanism, plates and camera pose.
        states: (..., J) true joint states [rad] at times (...) of the log [s].
        camera: the true one.
        readout_s: of its shutter.
    """

    stage: Stage
    states: Callable[[FloatArray], FloatArray]
    camera: CameraModel
    readout_s: float = 0.0

    def joint(self, name: str) -> int:
        """Column of a joint."""
        return self.stage.joints.index(name)

    def corner_states(self, observations: ObservationLog) -> FloatArray:
        """(N, 4, J) the joints at the very time at which each corner's row was exposed."""
        t_s = np.repeat(observations.t_s[observations.frame][:, None], 4, axis=1)
        if self.readout_s:
            rows_px = observations.corners_px[..., 1]
            t_s = t_s + row_delay_s(rows_px, self.camera.size_px[1], self.readout_s)
        return self.states(t_s)

    def plate_of(self, marker_id: IntArray) -> IntArray:
        """Which of the stage's plates each marker is."""
        plate = {plate.marker_id: p for p, plate in enumerate(self.stage.plates)}
        return np.array([plate[m] for m in marker_id.tolist()], dtype=np.int64)

    def corners(self, observations: ObservationLog) -> FloatArray:
        """(N, 4, 2) px at which a perfect detector would have seen the corners, without a shift of edges."""
        plates = self.stage.plates
        plate = self.plate_of(observations.marker_id)
        body = np.array([each.body for each in plates])[plate]
        T_body_marker = np.stack([each.T_body_marker for each in plates])[plate]
        points_m = np.array([each.size_m for each in plates])[plate, None, None] * UNIT_CORNERS
        T_cam_body = self.stage.T_camera_bodies(self.corner_states(observations))
        T = T_cam_body[np.arange(len(body)), :, body] @ T_body_marker[:, None]
        return project(self.camera, (T[..., :3, :3] @ points_m[..., None])[..., 0] + T[..., :3, 3])


@dataclass(frozen=True, eq=False)
class CornerNoise:
    """What the detected corners of a log have, beside what is stated of them.

    Attributes:
        edge_shift_px: that fits all best.
        error_px: (N, 8) detected less true, the shift taken out.
        stated_px2: (N, 8, 8) covariance, as the fit takes it.
        marker_id: (M,).
        scale: (M,) measured standard deviation over the stated one: by the median, which occluded corners don't move.
    """

    edge_shift_px: float
    error_px: FloatArray
    stated_px2: FloatArray
    marker_id: IntArray
    scale: FloatArray
    chi2: FloatArray

    def measured_px2(self, observations: ObservationLog) -> FloatArray:
        """(N, 8, 8) the stated covariances with the markers' measured scales."""
        of_row = self.scale[np.searchsorted(self.marker_id, observations.marker_id)]
        return of_row[:, None, None] ** 2 * self.stated_px2

    @property
    def hidden(self) -> BoolArray:
        """(N,) sightings that are so far off that something hid them in part."""
        return self.chi2 > OUTLIER_CHI2

    @property
    def rms_px(self) -> float:
        """Of a coordinate, over the sightings that are no outliers."""
        return float(np.sqrt(np.mean(self.error_px[~self.hidden] ** 2)))


# Of eight coordinates, in their stated covariance: one in 1e8 of good ones is beyond.
OUTLIER_CHI2 = 55.0


def corner_noise(truth: Truth, observations: ObservationLog, table: MarkerTable, camera: CameraModel) -> CornerNoise:
    """Detected corners against the truth."""
    error_px = (observations.corners_px - truth.corners(observations)).reshape(-1, COORDINATES)
    stated = total_covariance(observations, table.sizes_m(observations.marker_id), camera)
    weight = np.linalg.inv(stated)
    by_shift = edge_shift_jacobian(observations.corners_px).reshape(-1, COORDINATES)
    shift_px = 0.0
    for _ in range(ROUNDS):
        left = error_px - shift_px * by_shift
        chi2 = np.einsum("ni,nij,nj->n", left, weight, left)
        good = chi2 < OUTLIER_CHI2
        gain = np.einsum("ni,nij->nj", by_shift[good], weight[good])
        shift_px = float(np.sum(gain * error_px[good]) / np.sum(gain * by_shift[good]))
    left = error_px - shift_px * by_shift
    chi2 = np.einsum("ni,nij,nj->n", left, weight, left)
    ids = np.unique(observations.marker_id)
    median = np.array([np.median(chi2[observations.marker_id == m]) for m in ids.tolist()])
    return CornerNoise(shift_px, left, stated, ids, np.sqrt(median / chi2_quantile(0.5, COORDINATES)), chi2)


# In which the outliers are found and the shift settles.
ROUNDS = 4


@dataclass(frozen=True, eq=False)
class StateErrors:
    """A joint's states against the truth, at the fit's times, after its sign and the offset of its zero.

    Attributes:
        joint: the rig's name of it.
        fitted: the fit's.
        error_rad: (T,) NaN where there is no state.
        std_rad: (T,) as stated.
        t_s: (T,).
    """

    joint: str
    fitted: str
    t_s: FloatArray
    error_rad: FloatArray
    std_rad: FloatArray

    @property
    def rmse_deg(self) -> float:
        """NaN of a joint without states."""
        seen = np.isfinite(self.error_rad)
        return float(np.degrees(np.sqrt(np.mean(self.error_rad[seen] ** 2)))) if seen.any() else np.nan


def state_errors(fit: Fit, truth: Truth, part_bodies: dict[str, str]) -> dict[str, StateErrors]:
    """Those of the fit's revolute joints that are the rig's, by the rig's names.

    Args:
        fit: of the pictures.
        truth: behind them.
        part_bodies: the body of each part.
    """
    rig = {frozenset((joint.parent, joint.child)): joint.name for joint in truth.stage.tree.joints}
    found: dict[str, StateErrors] = {}
    for joint in fit.tree.joints:
        name = rig.get(frozenset((part_bodies[joint.parent], part_bodies[joint.child])))
        if name is None or joint.type != "revolute":
            continue
        column = fit.states.joints.index(joint.columns[0])
        q, true = fit.states.q[:, column], truth.states(fit.states.t_s)[:, truth.joint(name)]
        std = np.full(q.shape, np.nan) if fit.states.std is None else fit.states.std[:, column]
        found.setdefault(name, StateErrors(name, joint.name, fit.states.t_s, centred(q, true), std))
    return found


def centred(q: FloatArray, true: FloatArray) -> FloatArray:
    """(T,) states less the true ones, turned to agree with them and without their mean difference."""
    seen = np.isfinite(q)
    sign = np.sign(np.sum((q[seen] - q[seen].mean()) * (true[seen] - true[seen].mean())))
    error = sign * q - true
    return error - error[seen].mean()


def part_bodies(truth: Truth, table: MarkerTable) -> dict[str, str]:
    """The body that each part is on."""
    bodies = truth.stage.tree.parts
    body = {plate.marker_id: bodies[plate.body] for plate in truth.stage.plates}
    return {marker.part: body[marker.id] for marker in table.markers}
