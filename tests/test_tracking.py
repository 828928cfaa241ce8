from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from calibration.intrinsics import CameraModel, FloatArray, project
from station.kinematics import se3
from station.logs import PoseLog
from station.perception.choice import choose_over_time, chosen_poses
from station.perception.corner_noise import (
    SMALLEST_SIGMA_PX,
    UNSEEN_SIGMA_PX,
    estimate_scale,
    estimate_sigma_px,
    evidence_weights,
    total_covariance,
)
from station.perception.corners import Detections
from station.perception.hypotheses import PoseHypotheses
from station.perception.joint_covariance import joint_covariance
from station.perception.markers import Marker, MarkerTable
from station.perception.observations import ObservationBuilder, ObservationLog
from station.perception.pose import UNIT_CORNERS, estimate_poses, squared_corner_errors
from station.quadrilaterals import shift_edges
from station.simulate.render import SceneRenderer
from station.simulate.scene import CameraOptics, Plate
from station.tracking import (
    estimate_pose_log,
    observe,
    observe_frames,
    reestimate,
    track_parts,
    viewing_angles,
    viewing_angles_of_parts,
)
from tests.noisy_corners import independent, of_edges

SIZE_M = 0.05
FPS = 30.0
DICTIONARY = "DICT_4X4_50"
CAMERA = CameraModel(
    size_px=(640, 480),
    matrix=np.array([[600.0, 0, 320], [0, 600, 240], [0, 0, 1]]),
    distortion=np.array([0.05, -0.1, 0.001, 0.0, 0.0]),
)
ONE = MarkerTable(DICTIONARY, (Marker(4, "lid", SIZE_M),))
FACING = np.diag([1.0, -1.0, -1.0])
AHEAD = np.array([0.0, 0.0, 0.6])
# Of two candidates one is clearly nearer to the truth if it is so by more than this share of what they are apart.
CLEARLY = 0.3


def tilted(tilt_deg: FloatArray, azimuth_rad: FloatArray | float = 0.4) -> FloatArray:
    """(F, 4, 4) a marker 0.6 m straight ahead, its normal off the line of sight by the tilts (F,)."""
    axis = np.stack([np.cos(azimuth_rad), np.sin(azimuth_rad), 0.0 * np.asarray(azimuth_rad)], axis=-1)
    return se3.pose(se3.exp_so3(np.deg2rad(np.asarray(tilt_deg))[..., None] * axis) @ FACING, AHEAD)


def corners_px(T_cam_marker: FloatArray, size_m: float = SIZE_M) -> FloatArray:
    """(..., 4, 2) exact corners."""
    p_cam = (T_cam_marker[..., None, :3, :3] @ (size_m * UNIT_CORNERS)[..., None])[..., 0]
    return project(CAMERA, p_cam + T_cam_marker[..., None, :3, 3])


def watch(
    T_cam_part: FloatArray, table: MarkerTable, sigma_px: float, *, seed: int = 0, noise: Callable = independent
) -> ObservationLog:
    """Observations of all markers of the table, its parts moving as T_cam_part (F, K, 4, 4) say, with noisy corners."""
    part = [table.parts.index(m.part) for m in table.markers]
    T = T_cam_part[:, part] @ np.stack([m.mount for m in table.markers])
    px = np.stack([corners_px(T[:, k], m.size_m) for k, m in enumerate(table.markers)], axis=1)
    frames, count = px.shape[:2]
    px = noise(px.reshape(-1, 4, 2), sigma_px, np.random.default_rng(seed)).reshape(px.shape)
    poses = estimate_poses(px.reshape(-1, 4, 2), np.tile([m.size_m for m in table.markers], frames), CAMERA)
    return ObservationLog(
        t_s=np.arange(frames) / FPS,
        frame=np.repeat(np.arange(frames), count),
        marker_id=np.tile([m.id for m in table.markers], frames),
        corners_px=px.reshape(-1, 4, 2),
        corner_covariance_px2=np.full((px[..., 0, 0].size, 4, 2, 2), np.nan),
        T_cam_marker=poses.T_cam_marker,
        rms_px=poses.rms_px,
    )


def detected(ids: list[int], px: FloatArray) -> Detections:
    return Detections(np.array(ids, dtype=np.int64), px, np.full((len(ids), 4, 2, 2), np.nan))


def rotation_errors_deg(T: FloatArray, truth: FloatArray) -> FloatArray:
    return np.rad2deg(se3.angle(np.swapaxes(truth[..., :3, :3], -1, -2) @ T[..., :3, :3]))


def normalised_errors(log: PoseLog, T_cam_part: FloatArray) -> FloatArray:
    """(T, K) squared errors in units of the stated covariance, over 6."""
    assert log.covariance is not None
    error = se3.log(se3.inverse(T_cam_part) @ log.T_ref_part)
    return np.einsum("tki,tkij,tkj->tk", error, np.linalg.inv(log.covariance), error) / 6


def flips(hypotheses: PoseHypotheses, chosen: np.ndarray, truth: FloatArray) -> int:
    """In how many frames the candidate of the first part that wasn't chosen (F,) is clearly nearer to the truth."""
    T = hypotheses.T_cam_part[:, 0]
    off_deg = np.nan_to_num(rotation_errors_deg(T, truth[:, None]), nan=180.0)
    apart_deg = np.nan_to_num(rotation_errors_deg(T[:, 0], T[:, 1]))
    taken = np.take_along_axis(off_deg, chosen[:, None], axis=1)[:, 0]
    return int(np.sum(taken > off_deg.min(axis=1) + CLEARLY * apart_deg + 1e-6))


@pytest.mark.parametrize("motion", ["static", "turning", "swinging"])
def test_flips_are_repaired_over_time(motion: str) -> None:
    t_s = np.arange(240) / FPS
    azimuth_rad = {"static": 0 * t_s, "turning": 1.5 * t_s, "swinging": 0.5 * np.sin(2 * t_s)}[motion]
    truth = tilted(np.full(len(t_s), 12.0), azimuth_rad)
    tracked = track_parts(watch(truth[:, None], ONE, sigma_px=0.3), ONE, CAMERA)
    assert flips(tracked.hypotheses, np.zeros(240, dtype=int), truth) >= 15
    chosen, ambiguous = tracked.choice.chosen[:, 0], tracked.choice.ambiguous[:, 0]
    assert flips(tracked.hypotheses, chosen, truth) <= 2
    assert ambiguous.mean() < 0.2


def test_a_swing_through_the_front_keeps_its_side() -> None:
    tilt_deg = 30 * np.cos(np.arange(180) / FPS)
    truth = tilted(tilt_deg)
    observations = watch(truth[:, None], ONE, sigma_px=0.1)
    log = estimate_pose_log(observations, ONE, CAMERA)
    oblique = np.abs(tilt_deg) > 10
    assert rotation_errors_deg(log.T_ref_part[oblique, 0], truth[oblique]).max() < 5.0


def two_candidates(chi2: FloatArray, frames: int = 1) -> PoseHypotheses:
    """A lid in each frame, at a tilt of 10 deg to one side or the other, with squared errors (2,) of the corners."""
    T = np.stack([tilted(np.array(10.0)), tilted(np.array(-10.0))])
    covariance = np.diag([1e-6] * 3 + [1e-4] * 3)
    return PoseHypotheses(
        np.arange(frames) / FPS,
        ("lid",),
        np.broadcast_to(T, (frames, 1, 2, 4, 4)),
        np.broadcast_to(covariance, (frames, 1, 2, 6, 6)),
        np.broadcast_to(chi2, (frames, 1, 2)),
        np.ones((frames, 1)),
    )


def test_a_choice_that_nothing_decides_is_called_ambiguous_and_its_covariance_reaches_the_other() -> None:
    candidates = two_candidates(np.array([2.0, 2.0]))
    choice = choose_over_time(candidates)
    assert choice.probability[0, 0] == pytest.approx(0.5) and choice.ambiguous[0, 0]
    covariance = chosen_poses(candidates, choice).covariance
    assert covariance is not None
    widest_deg = np.rad2deg(np.sqrt(np.linalg.eigvalsh(covariance[0, 0, 3:, 3:])[-1]))
    assert widest_deg > 0.5**0.5 * 20  # half the weight is on a pose 20 deg away


def test_what_one_frame_leaves_open_many_decide() -> None:
    alone, together = (choose_over_time(two_candidates(np.array([2.0, 3.0]), n)) for n in (1, 30))
    assert alone.ambiguous.all() and not together.ambiguous.any()
    assert np.all(together.chosen == 0)


def test_frames_that_show_the_same_errors_count_once_for_those() -> None:
    still = watch(tilted(np.full(100, 20.0))[:, None], ONE, sigma_px=0.05)
    moving = watch(tilted(np.linspace(20, 70, 20))[:, None], ONE, sigma_px=0.05)
    # However many looks there are, they tell no more than one and a bit, as most of their error is common.
    assert 1 <= 100 * evidence_weights(still)[0] < 2
    assert evidence_weights(moving).min() > 0.5


@pytest.mark.parametrize("tilt_deg", [0.0, 5.0, 20.0, 50.0, 70.0])
def test_stated_covariances_are_honest(tilt_deg: float) -> None:
    truth = tilted(np.full(900, tilt_deg))[:, None]
    seen = stating(watch(truth, ONE, sigma_px=0.05, seed=int(tilt_deg), noise=of_edges), 0.05)
    log = estimate_pose_log(seen, ONE, CAMERA)
    # The mean of 900 chi-squared of 6 over 6 is 1 +- 0.02, the scale's own estimate is good to 5 %.
    assert 0.8 < normalised_errors(log, truth).mean() < 1.25


def test_sigma_is_found_from_the_residuals_despite_bad_rows() -> None:
    observations = watch(tilted(np.full(400, 40.0))[:, None], ONE, sigma_px=0.15)
    rms_px = observations.rms_px[:, 0].copy()
    rms_px[::10] = 3.0
    assert estimate_sigma_px(rms_px) == pytest.approx(0.15, rel=0.2)


@pytest.mark.parametrize("rms_px", [np.zeros(0), np.full(5, np.nan), np.full(5, 1e-4)])
def test_sigma_is_never_taken_as_less_than_model_error(rms_px: FloatArray) -> None:
    assert estimate_sigma_px(rms_px) == SMALLEST_SIGMA_PX


def stating(observations: ObservationLog, sigma_px: float) -> ObservationLog:
    """The same, the detector stating that the lines of the edges are good to `sigma_px` at each corner."""
    shape = observations.corner_covariance_px2.shape
    return replace(observations, corner_covariance_px2=np.broadcast_to(sigma_px**2 * np.eye(2), shape))


def scale_of(stated: ObservationLog) -> float:
    joint = joint_covariance(stated.corners_px, stated.corner_covariance_px2)
    T = stated.T_cam_marker[:, 0]
    return estimate_scale(squared_corner_errors(T, stated.corners_px, SIZE_M, CAMERA, joint))


@pytest.mark.parametrize("said_px", [0.05, 0.1, 0.2])
def test_stated_covariances_are_scaled_to_what_the_residuals_of_a_log_show(said_px: float) -> None:
    truth = tilted(np.full(400, 40.0))[:, None]
    seen = stating(watch(truth, ONE, sigma_px=0.1, noise=of_edges), said_px)
    assert scale_of(seen) == pytest.approx((0.1 / said_px) ** 2, rel=0.25)
    assert 0.8 < normalised_errors(estimate_pose_log(seen, ONE, CAMERA), truth).mean() < 1.25


def test_a_few_residuals_do_not_overrule_the_detector() -> None:
    few = stating(watch(tilted(np.full(3, 40.0))[:, None], ONE, sigma_px=0.0), 0.1)
    assert 0.8 < scale_of(few) <= 1.0


def test_what_no_residual_shows_is_added_to_stated_covariances() -> None:
    perfect = stating(watch(tilted(np.full(100, 40.0))[:, None], ONE, sigma_px=0.0), 0.001)
    total = total_covariance(perfect, np.full(100, SIZE_M), CAMERA)
    assert np.all(np.diagonal(total, axis1=-2, axis2=-1) >= UNSEEN_SIGMA_PX**2)


def test_oblique_views_are_dropped() -> None:
    tilt_deg = np.array([60.0, 70.0, 74.0, 76.0, 80.0])
    log = estimate_pose_log(watch(tilted(tilt_deg)[:, None], ONE, sigma_px=0.02), ONE, CAMERA)
    assert log.seen[:, 0].tolist() == [True, True, True, False, False]
    assert log.covariance is not None
    assert np.all(np.isnan(log.covariance[3:]))


def test_a_shape_that_is_no_square_is_dropped_and_a_poor_one_trusted_less() -> None:
    clean = watch(tilted(np.full(60, 30.0))[:, None], ONE, sigma_px=0.05)
    px = clean.corners_px.copy()
    px[10, 0] += 4.0
    px[20, 0] += 0.3
    spoilt = reestimate(replace(clean, corners_px=px), ONE, CAMERA)
    log, undisturbed = estimate_pose_log(spoilt, ONE, CAMERA), estimate_pose_log(clean, ONE, CAMERA)
    assert not log.seen[10, 0]
    assert log.seen[20, 0]
    assert log.covariance is not None and undisturbed.covariance is not None
    assert np.trace(log.covariance[20, 0]) > 1.5 * np.trace(undisturbed.covariance[20, 0])


def test_parts_times_and_gaps_are_the_tables_and_the_observations() -> None:
    table = MarkerTable(DICTIONARY, (Marker(9, "late", SIZE_M), Marker(4, "lid", SIZE_M)))
    stranger_too = MarkerTable(DICTIONARY, (*table.markers, Marker(17, "stranger", SIZE_M)))
    builder = ObservationBuilder()
    px = corners_px(tilted(np.array([20.0])))
    t_s = [0.0, 0.033, 0.071]
    for stamp, ids in zip(t_s, ([4], [], [17]), strict=True):  # 17 is in nobody's table
        builder.add(stamp, observe(detected(ids, px[: len(ids)]), stranger_too, CAMERA))
    log = estimate_pose_log(builder.build(), table, CAMERA)
    assert (log.reference, log.parts, log.t_s.tolist()) == ("camera", ("late", "lid"), t_s)
    assert log.seen.tolist() == [[False, True], [False, False], [False, False]]


def test_a_log_without_observations_has_unseen_parts() -> None:
    builder = ObservationBuilder()
    for t_s in (0.0, 0.1):
        builder.add(t_s, observe(detected([], np.zeros((0, 4, 2))), ONE, CAMERA))
    log = estimate_pose_log(builder.build(), ONE, CAMERA)
    assert not np.any(log.seen)


MOUNTS = (
    se3.pose(se3.exp_so3(np.array([0.0, 0.5, 0.0])), np.array([0.05, 0.0, -0.01])),
    se3.pose(se3.exp_so3(np.array([0.0, -0.5, 0.1])), np.array([-0.05, 0.01, -0.02])),
)
BRACKET = MarkerTable(DICTIONARY, tuple(Marker(k, "bracket", SIZE_M, mount) for k, mount in enumerate(MOUNTS)))


def test_a_mount_takes_the_marker_to_its_part() -> None:
    table = MarkerTable(DICTIONARY, BRACKET.markers[:1])
    truth = tilted(np.linspace(0, 20, 300))[:, None]
    exact = estimate_pose_log(watch(truth, table, sigma_px=0.0), table, CAMERA)
    np.testing.assert_allclose(exact.T_ref_part, truth, atol=1e-6)  # m; 1e-5 rad is where the refinement ends
    noisy = estimate_pose_log(watch(truth, table, sigma_px=0.1), table, CAMERA)
    assert 0.8 < normalised_errors(noisy, truth).mean() < 1.25  # the lever arm is in the covariance


def test_two_markers_of_a_part_tell_more_than_each() -> None:
    truth = tilted(np.linspace(0, 20, 300))[:, None]
    observations = watch(truth, BRACKET, sigma_px=0.1)
    both = estimate_pose_log(observations, BRACKET, CAMERA)
    alone = [
        estimate_pose_log(observations, MarkerTable(DICTIONARY, (marker,)), CAMERA).T_ref_part
        for marker in BRACKET.markers
    ]
    fused_deg = np.sqrt(np.mean(rotation_errors_deg(both.T_ref_part, truth) ** 2))
    assert all(fused_deg < 0.85 * np.sqrt(np.mean(rotation_errors_deg(T, truth) ** 2)) for T in alone)
    assert 0.8 < normalised_errors(both, truth).mean() < 1.3


def test_markers_that_disagree_make_the_part_less_certain() -> None:
    truth = tilted(np.full(20, 10.0))[:, None]
    seen = watch(truth, BRACKET, sigma_px=0.1)
    bent = MOUNTS[1] @ se3.exp(np.array([0.0, 0, 0, 0, 0.05, 0]))
    wrong = MarkerTable(DICTIONARY, (BRACKET.markers[0], replace(BRACKET.markers[1], T_part_marker=bent)))
    right_covariance, wrong_covariance = (
        estimate_pose_log(seen, table, CAMERA).covariance for table in (BRACKET, wrong)
    )
    assert right_covariance is not None and wrong_covariance is not None
    assert np.trace(wrong_covariance[0, 0]) > 5 * np.trace(right_covariance[0, 0])


def test_a_marker_from_the_side_tells_which_way_a_frontal_one_of_its_part_leans() -> None:
    mounts = (np.eye(4), se3.pose(se3.exp_so3(np.array([0.0, 0.7, 0.0])), np.array([0.06, 0.0, -0.02])))
    table = MarkerTable(DICTIONARY, tuple(Marker(k, "bracket", SIZE_M, mount) for k, mount in enumerate(mounts)))
    truth = tilted(np.full(200, 12.0), 2.0)
    seen = watch(truth[:, None], table, sigma_px=0.4)
    frontal = track_parts(seen, MarkerTable(DICTIONARY, table.markers[:1]), CAMERA).hypotheses
    both = track_parts(seen, table, CAMERA)
    assert flips(frontal, np.zeros(200, dtype=int), truth) > 20
    assert flips(both.hypotheses, np.zeros(200, dtype=int), truth) == 0
    assert not both.choice.ambiguous.any()


def test_poses_follow_the_camera_that_is_given() -> None:
    truth, shift_px = tilted(np.full(10, 30.0)), -0.3
    clean = watch(truth[:, None], ONE, sigma_px=0.0)
    smaller = replace(clean, corners_px=shift_edges(clean.corners_px, shift_px))
    shifted = replace(CAMERA, edge_shift_px=shift_px)
    log = estimate_pose_log(reestimate(smaller, ONE, shifted), ONE, shifted)
    np.testing.assert_allclose(log.T_ref_part[:, 0], truth, atol=1e-6)  # m, rad: where the refinement ends


def test_viewing_angles_by_marker_and_by_part() -> None:
    observations = watch(tilted(np.array([0.0, 10.0]))[:, None], BRACKET, sigma_px=0.0)
    by_marker = viewing_angles(observations).reshape(2, 2)
    by_part = viewing_angles_of_parts(observations, BRACKET)
    np.testing.assert_allclose(by_part[:, 0], by_marker.min(axis=1))
    assert np.all((np.rad2deg(by_marker) > 20) & (np.rad2deg(by_marker) < 40))  # mounted at 0.5 rad
    unseen = MarkerTable(DICTIONARY, (Marker(30, "other", SIZE_M),))
    assert np.all(np.isnan(viewing_angles_of_parts(observations, unseen)))


def test_a_detection_that_is_not_in_the_table_is_left_out() -> None:
    px = corners_px(tilted(np.array([20.0, 30.0])))
    seen = observe(detected([17, 4], px), ONE, CAMERA)
    assert seen.marker_id.tolist() == [4]
    np.testing.assert_array_equal(seen.corners_px, px[1:])


@pytest.fixture(scope="module")
def rendered() -> Callable[[FloatArray], np.ndarray]:
    """rendered(T_cam_part (4, 4)) -> the image of the bracket there."""
    plates = [Plate(0, m.mount, m.size_m, 0.01, m.id) for m in BRACKET.markers]
    optics = CameraOptics(CAMERA.size_px, CAMERA.matrix, CAMERA.distortion, blur_px=0.7, noise_grey=2.0, gamma=2.2)
    renderer = SceneRenderer(plates, [], DICTIONARY, optics, seed=0)
    return lambda T: renderer.render(T[None], 0)


def test_images_become_poses(rendered: Callable[[FloatArray], np.ndarray]) -> None:
    truth = tilted(np.linspace(-10, 15, 6))
    observations = observe_frames(((f / FPS, rendered(T)) for f, T in enumerate(truth)), BRACKET, CAMERA)
    assert len(observations) == 12
    log = estimate_pose_log(observations, BRACKET, CAMERA)
    assert rotation_errors_deg(log.T_ref_part[:, 0], truth).max() < 0.3
    assert np.abs(log.T_ref_part[:, 0, :3, 3] - truth[:, :3, 3]).max() < 0.001  # m; mostly depth
