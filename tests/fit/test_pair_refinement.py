"""Least squares of pairs: frames whose states step too far, and frames judged by themselves."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from station.fit import pair_refinement
from station.fit.noise import unknown_noise
from station.fit.pair_model import Model, PairTracks
from station.fit.pair_refinement import Progress, begin, improve
from station.fit.pair_starts import start_models
from station.kinematics import se3
from station.kinematics.joints import JOINT_TYPES
from station.logs import FloatArray

IntArray = NDArray[np.intp]
REVOLUTE = JOINT_TYPES["revolute"]
STEPS = 20


def hinges(seed: int, *, noise_rad: float, pairs: int = 6, frames: int = 60) -> PairTracks:
    """Hinges on short arms, so that loud orientations alone tell the turns."""
    rng = np.random.default_rng([91, seed])
    q = np.linspace(-1.5, 1.5, frames)
    T = (
        se3.exp(0.5 * rng.normal(size=(pairs, 1, 6)))
        @ se3.rotation_z(q)
        @ se3.exp(0.1 * rng.normal(size=(pairs, 1, 6)))
    )
    T_meas = T @ se3.exp(rng.normal(size=(pairs, frames, 6)) * np.repeat([1e-3, noise_rad], 3))
    seen, one = np.ones((pairs, frames), dtype=bool), np.ones(pairs, dtype=bool)
    return PairTracks(T_meas, seen, seen, unknown_noise(T_meas, one, one), np.full(pairs, 1.0))


def settled(tracks: PairTracks, *, tolerance: float = 0.1) -> Progress:
    pairs = len(tracks.seen)
    start = begin(start_models(REVOLUTE, tracks, by_pose=True))
    return improve(REVOLUTE, tracks.data, start, iterations=STEPS, tolerance=np.full(pairs, tolerance))


def test_a_frame_s_state_that_steps_too_far_goes_half_the_way() -> None:
    """Half a step is the best that there is where a whole one lands as far on the other side."""
    tracks = hinges(0, noise_rad=0.02, pairs=2)
    progress = settled(tracks, tolerance=1e-6)
    model, data = progress.model, tracks.data
    whitening = data.noise.whitening(model.scales)
    far = model.q.copy()
    far[1, 7] -= 0.2
    before = _costs(tracks, replace(model, q=far))
    before[:, 0] += 100.0  # the pairs as wholes are better than before
    step = np.zeros_like(far)
    step[1, 7] = 2 * 0.2 * 1.05
    moved, cost = pair_refinement._judged(
        REVOLUTE, data, replace(model, q=far), step, whitening, whitening, before, np.zeros(2)
    )
    np.testing.assert_allclose(moved.q[1, 7], model.q[1, 7], atol=0.02)
    assert cost[1] < before[1].sum() - 100.0
    np.testing.assert_array_equal(moved.q[0], far[0])


def _costs(tracks: PairTracks, model: Model) -> FloatArray:
    rows, frames = (index.ravel() for index in np.indices(tracks.seen.shape))
    q = model.q[rows, frames]
    costs = pair_refinement._costs_of_frames(REVOLUTE, tracks.data, model, q, rows, frames, np.zeros(len(tracks.seen)))
    return costs.reshape(tracks.seen.shape)


def test_frames_of_pairs_cost_by_themselves_what_they_do_in_their_pairs() -> None:
    tracks = hinges(1, noise_rad=0.1)
    progress = settled(tracks)
    whitening = tracks.data.noise.whitening(progress.model.scales)
    step = np.zeros_like(progress.model.q)
    nothing = np.full(tracks.seen.shape, np.inf)
    _, cost = pair_refinement._judged(
        REVOLUTE, tracks.data, progress.model, step, whitening, whitening, nothing, np.zeros(len(step))
    )
    np.testing.assert_allclose(_costs(tracks, progress.model).sum(axis=-1), cost, rtol=1e-12)
