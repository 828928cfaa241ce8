"""Are the stated covariances of poses honest? Squared errors in their units, over 6, which should be 1 on average.

Single frames of a 50 mm marker at random places, over tilt and distance, as one log: corners whose edges have Gaussian
noise, and rendered frames through the real detector. The better of the two candidates counts ("nearest"; the choice is
another benchmark's), and beside it the one that its own corners prefer, its covariance widened by the other where that
isn't certain ("chosen"). Then a part with two markers, and rolling shutter: rotation errors uncorrected and corrected.

Run: python -m tests.benchmarks.pose_covariance [--quick]
"""

from __future__ import annotations

import numpy as np

from calibration.intrinsics import project
from station.kinematics import se3
from station.logs import FloatArray
from station.perception.choice import choose_by_corners, chosen_poses
from station.perception.joint_covariance import joint_covariance
from station.perception.markers import Marker, MarkerTable
from station.perception.observations import ObservationLog
from station.perception.pose import UNIT_CORNERS, estimate_poses
from station.perception.rolling_shutter import row_delay_s
from station.tracking import TrackedParts, track_parts
from tests.benchmarks.arguments import parser, trials_of
from tests.benchmarks.watched_marker import CAMERA, FPS, SIZE_M, TABLE, observed
from tests.noisy_corners import of_edges
from tests.rendered_markers import DICTIONARY, facing

TILTS_DEG = (0, 3, 6, 10, 20, 40, 60, 70)
DISTANCES_M = (0.3, 0.6, 1.0)
SYNTHETIC_SIGMA_PX = 0.05
READOUT_S = 0.025
MOUNTS = (
    se3.pose(se3.exp_so3(np.array([0.0, 0.5, 0.0])), np.array([0.05, 0.0, -0.01])),
    se3.pose(se3.exp_so3(np.array([0.0, -0.5, 0.1])), np.array([-0.05, 0.01, -0.02])),
)
BRACKET = MarkerTable(DICTIONARY, tuple(Marker(k, "bracket", SIZE_M, mount) for k, mount in enumerate(MOUNTS)))


def places(rng: np.random.Generator, count: int, tilt_deg: float, distance_m: float) -> FloatArray:
    """(N, 4, 4) all over the middle of the picture, turned any way."""
    across = rng.uniform((-0.3, -0.2), (0.3, 0.2), (count, 2)) * distance_m
    t_m = np.concatenate([across, np.full((count, 1), distance_m)], axis=1)
    azimuth, spin = rng.uniform(0, 2 * np.pi, (2, count))
    return facing(np.full(count, np.deg2rad(tilt_deg)), azimuth, spin, t_m)


def corners(T_cam_part: FloatArray, table: MarkerTable) -> FloatArray:
    """(..., M, 4, 2) exact corners of the table's markers."""
    T = T_cam_part[..., None, :, :] @ np.stack([m.mount for m in table.markers])
    p_cam = (T[..., None, :3, :3] @ (SIZE_M * UNIT_CORNERS)[..., None])[..., 0] + T[..., None, :3, 3]
    return project(CAMERA, p_cam)


def noisy(px: FloatArray, table: MarkerTable, rng: np.random.Generator, sigma_px: float) -> ObservationLog:
    """Corners (F, M, 4, 2) with noise as of lines fitted to the edges, stated."""
    frames, count = px.shape[:2]
    exact = px.reshape(-1, 4, 2)
    stated = np.broadcast_to(sigma_px**2 * np.eye(2), (*exact.shape[:2], 2, 2))
    seen = of_edges(exact, sigma_px, rng)
    poses = estimate_poses(seen, SIZE_M, CAMERA, joint_covariance(seen, stated))
    return ObservationLog(
        np.arange(frames) / FPS,
        np.repeat(np.arange(frames), count),
        np.tile([m.id for m in table.markers], frames),
        seen,
        stated,
        poses.T_cam_marker,
        poses.rms_px,
    )


def normalised(T: FloatArray, covariance: FloatArray, truth: FloatArray) -> FloatArray:
    """(N,) squared errors in units of the covariance, over 6."""
    error = se3.log(se3.inverse(truth) @ T)
    return np.einsum("ni,nij,nj->n", error, np.linalg.inv(covariance), error) / 6


def errors(tracked: TrackedParts, truth: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Normalised errors (F,) of the nearer candidate, and of the one chosen by the frame's corners; NaN if unseen."""
    hypotheses = tracked.hypotheses
    off = se3.angle(np.swapaxes(truth[:, None, :3, :3], -1, -2) @ hypotheses.T_cam_part[:, 0, :, :3, :3])
    rows, nearest = np.arange(len(truth)), np.argmin(np.nan_to_num(off, nan=np.inf), axis=1)
    log = chosen_poses(hypotheses, choose_by_corners(hypotheses))
    assert log.covariance is not None
    near = normalised(hypotheses.T_cam_part[rows, 0, nearest], hypotheses.covariance[rows, 0, nearest], truth)
    return near, normalised(log.T_ref_part[:, 0], log.covariance[:, 0], truth)


def cell_text(near: FloatArray, chosen: FloatArray) -> str:
    """Both means, and of how many frames."""
    seen = int(np.isfinite(near).sum())
    return f"{np.nanmean(near):6.2f} /{np.nanmean(chosen):6.2f} ({seen:4})" if seen else f"{'-':>22}"


def table(kind: str, seed: int, trials: int) -> None:
    """Rows of tilts, columns of distances: nearest and chosen."""
    print(f"\n{kind}: mean of normalised squared errors, nearest / chosen (frames)")
    print("tilt [deg]  " + "  ".join(f"{d:>10.1f} m        " for d in DISTANCES_M))
    rng = np.random.default_rng(seed)
    cells = [(tilt, distance) for tilt in TILTS_DEG for distance in DISTANCES_M]
    truth = np.concatenate([places(rng, trials, *which) for which in cells])
    rendered = kind.startswith("rendered")
    seen = observed(truth, seed=seed) if rendered else noisy(corners(truth, TABLE), TABLE, rng, SYNTHETIC_SIGMA_PX)
    near, chosen = (
        by_frame.reshape(len(cells), trials) for by_frame in errors(track_parts(seen, TABLE, CAMERA), truth)
    )
    texts = [
        f"{np.nanmean(a):6.2f} /{np.nanmean(b):6.2f} ({np.isfinite(a).sum():4})"
        if np.isfinite(a).any()
        else f"{'-':>20}"
        for a, b in zip(near, chosen, strict=True)
    ]
    for k, tilt in enumerate(TILTS_DEG):
        print(f"{tilt:10}  " + "  ".join(texts[k * len(DISTANCES_M) : (k + 1) * len(DISTANCES_M)]))
    print(f"all: {np.nanmean(near):.2f} / {np.nanmean(chosen):.2f}", flush=True)


def two_markers(seed: int, trials: int) -> None:
    """A part with two markers whose mounts are known, fitted together."""
    print("\npart with two markers 57 deg apart, synthetic corners: normalised squared error, rotation RMS [deg]")
    for tilt in (0, 10, 30):
        rng = np.random.default_rng((seed, tilt))
        truth = places(rng, 4 * trials, tilt, 0.6)
        log = track_parts(noisy(corners(truth, BRACKET), BRACKET, rng, SYNTHETIC_SIGMA_PX), BRACKET, CAMERA).poses
        seen = log.seen[:, 0]
        assert log.covariance is not None
        squared = normalised(log.T_ref_part[seen, 0], log.covariance[seen, 0], truth[seen])
        off = se3.angle(np.swapaxes(truth[seen, :3, :3], -1, -2) @ log.T_ref_part[seen, 0, :3, :3])
        print(f"{tilt:10}  {squared.mean():6.2f}  {np.rad2deg(np.sqrt(np.mean(off**2))):8.3f}")


def rolling(seed: int) -> None:
    """A marker on a swinging link under a rolling shutter."""
    print(f"\nrolling shutter of {READOUT_S * 1e3:.0f} ms, marker on a swinging link of 12 cm: rotation RMS [deg]")
    print("fastest [deg/s]  global shutter  uncorrected  corrected  normalised error, corrected")
    t_s = np.arange(300) / FPS
    for amplitude in (0.3, 0.6, 1.0):
        rng = np.random.default_rng(seed)
        exact = corners(swung(t_s, amplitude), TABLE)
        plain = noisy(exact, TABLE, rng, SYNTHETIC_SIGMA_PX)
        read = noisy(rolled(t_s, amplitude), TABLE, rng, SYNTHETIC_SIGMA_PX)
        truth, cells = swung(t_s, amplitude), []
        for seen, readout_s in ((plain, 0.0), (read, 0.0), (read, READOUT_S)):
            log = track_parts(seen, TABLE, CAMERA, sigma_px=SYNTHETIC_SIGMA_PX, readout_s=readout_s).poses
            assert log.covariance is not None
            off = se3.angle(np.swapaxes(truth[:, :3, :3], -1, -2) @ log.T_ref_part[:, 0, :3, :3])
            cells.append(np.rad2deg(np.sqrt(np.mean(off**2))))
            squared = normalised(log.T_ref_part[:, 0], log.covariance[:, 0], truth)
        print(
            f"{np.rad2deg(3 * amplitude):15.0f}  " + "  ".join(f"{c:12.3f}" for c in cells) + f"  {squared.mean():8.2f}"
        )


def swung(t_s: FloatArray, amplitude: float) -> FloatArray:
    """(..., 4, 4) the marker on its link."""
    swing, zero = amplitude * np.sin(3.0 * t_s), np.zeros_like(t_s)
    pivot = se3.pose(np.diag([1.0, -1.0, -1.0]) @ se3.exp_so3(np.array([0.5, 0.3, 0.0])), np.array([0.0, 0.05, 0.6]))
    turn = se3.exp(np.stack([zero, zero, zero, zero, 0.3 * swing, swing], axis=-1))
    return pivot @ turn @ se3.translation(np.array([0.0, 0.12, 0.0]))


def rolled(t_s: FloatArray, amplitude: float) -> FloatArray:
    """(F, 1, 4, 2) px of the corners, each where it was when its row was read."""
    seen_s = np.repeat(t_s[:, None], 4, axis=1)
    px = np.zeros((len(t_s), 4, 2))
    for _ in range(10):  # a corner's row depends on when it is read
        every = corners(swung(seen_s, amplitude), TABLE)[:, :, 0]
        px = every[:, np.arange(4), np.arange(4)]
        seen_s = t_s[:, None] + row_delay_s(px[..., 1], CAMERA.size_px[1], READOUT_S)
    return px[:, None]


def main() -> None:
    """Print all tables."""
    options = parser(__doc__, trials=100, quick=20).parse_args()
    trials = trials_of(options)
    table(f"synthetic corners, {SYNTHETIC_SIGMA_PX} px", options.seed, 5 * trials)
    table("rendered frames, real detector", options.seed, trials)
    two_markers(options.seed, trials)
    rolling(options.seed)


if __name__ == "__main__":
    main()
