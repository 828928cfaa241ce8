"""What errors fake is shared out where errors have habits, and only there."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from station.fit.bodies import bodies_of_log, pair_tracks, with_reference
from station.fit.comparison import fit_types
from station.fit.learner import learn
from station.fit.selection import score_fits
from station.logs import FloatArray, PoseLog
from tests.benchmarks.made_joints import Faults, poses, single_joint, watch

STD_M, STD_RAD = 0.003, 0.02
FRAMES = 300


def probabilities(log: PoseLog) -> dict[str, float]:
    tracks = pair_tracks(with_reference(bodies_of_log(log), "world"), np.array([[0, 1]]))
    types = ("rigid", "prismatic", "revolute")
    return score_fits(fit_types(tracks, types, quickly=False), tracks, "evidence", free=False).probabilities(0)


def arc(rng: np.random.Generator, radius_m: float, error_frames: float) -> PoseLog:
    """Half a metre of a circle; besides 1.5 mm of noise, which changes slowly or not."""
    angle = np.linspace(0, 0.5 / radius_m, FRAMES)
    way = radius_m * np.stack([np.sin(angle), 1 - np.cos(angle), 0 * angle], axis=-1)
    T = poses(np.outer(angle, [0.0, 0.0, 1.0]), way)
    return watch(rng, T[:, None], 0.0015, 0.006, Faults(error_frames=error_frames)).log


@pytest.mark.parametrize(
    ("radius_m", "error_frames", "slide"), [(4.0, 20.0, True), (2.0, 20.0, False), (2.0, 0.0, False)]
)
def test_an_arc_as_flat_as_trackers_bend_lines_is_a_slide(radius_m: float, error_frames: float, slide: bool) -> None:
    """Likelihood alone takes each of them for a hinge."""
    for seed in range(5):
        found = probabilities(arc(np.random.default_rng([150, seed]), radius_m, error_frames))
        assert found["prismatic" if slide else "revolute"] > 0.9


@pytest.mark.parametrize(("error_frames", "sure"), [(0.0, True), (20.0, False)])
def test_a_motion_within_the_noise_is_surer_where_errors_have_no_habits(error_frames: float, sure: bool) -> None:
    """A slide of 10 mm in all under 3 mm of noise."""
    found: list[float] = []
    for seed in range(5):
        rng = np.random.default_rng([151, seed])
        made = single_joint(rng, "prismatic", frames=FRAMES, travel=0.01, arm_m=0.0)
        log = watch(rng, made.T_ref_part, STD_M, STD_RAD, Faults(error_frames=error_frames)).log
        found.append(probabilities(log)["rigid"])
    assert (np.median(found) < 0.1) == sure


def drifted(rng: np.random.Generator, noise: FloatArray, keep: float) -> FloatArray:
    """(T, 6) errors of unit variance that keep so much of themselves from frame to frame."""
    return np.asarray(lfilter([1.0], [1.0, -keep], noise * np.sqrt(1 - keep**2), axis=0))


@pytest.mark.parametrize("frames", [60, 600])
def test_rigid_parts_that_wobble_slowly_are_rigid(frames: int) -> None:
    """Errors of 2 mm and 1 deg that last for a twentieth of the record."""
    right = 0
    for seed in range(10):
        rng = np.random.default_rng([152, seed])
        e = drifted(rng, rng.normal(size=(frames, 6)), np.exp(-20 / frames)) * np.repeat([0.002, 0.017], 3)
        T = poses(np.array([0.3, 0.2, 0.1]), np.array([0.2, 0.1, 0.6])) @ poses(e[:, 3:], e[:, :3])
        log = PoseLog(np.arange(frames) / 30, "world", ("shelf",), T[:, None])
        right += learn(log).tree.joints == ()
    assert right >= 9
