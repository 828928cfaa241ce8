"""Screws and balls: fits as good as the bound, over turns, from positions, told from the other types, in a tree."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from station.fit.comparison import fit_types
from station.fit.learner import learn
from station.fit.noise import unknown_noise
from station.fit.options import FitOptions
from station.fit.pairwise import JointFit, PairTracks, fit_joint, parameter_covariance
from station.fit.selection import score_fits
from station.kinematics.joints import JOINT_TYPES
from station.logs import FloatArray, PoseLog

SIGMA_M, SIGMA_RAD = 0.003, 0.02
ALL = tuple(JOINT_TYPES)


def poses(w: FloatArray, v: FloatArray) -> FloatArray:
    """(..., 4, 4) of rotation vectors and translations (..., 3)."""
    w, v = np.broadcast_arrays(w, v)
    T = np.zeros((*v.shape[:-1], 4, 4))
    T[..., :3, :3] = Rotation.from_rotvec(w.reshape(-1, 3)).as_matrix().reshape(*v.shape[:-1], 3, 3)
    T[..., :3, 3], T[..., 3, 3] = v, 1
    return T


def motion(kind: str, q: FloatArray, pitch: float = 0.0) -> FloatArray:
    """(..., 4, 4) about the origin and the z axis, by definition: q (...,), or (..., 3) of a ball."""
    if kind == "spherical":
        return poses(q, np.zeros(3))
    along = q[..., None] * np.array([0.0, 0.0, 1.0])
    turn, slide = {"rigid": (0, 0), "prismatic": (0, 1), "revolute": (1, 0), "screw": (1, pitch)}[kind]
    return poses(turn * along, slide * along)


def swept(rng: np.random.Generator, kind: str, pairs: int, frames: int, travel: float) -> FloatArray:
    """(pairs, frames) smooth states to and fro, or (pairs, frames, 3) of a ball."""
    t = np.linspace(0, 2 * np.pi, frames)[:, None]
    waves = np.sin(t * np.array([1.0, 2.0, 3.0]) + rng.uniform(0, 2 * np.pi, (pairs, 1, 3)))
    return 0.5 * travel * waves if kind == "spherical" else 0.5 * travel * waves[..., 0]


class Made:
    """Random joints of one type, tracked with noise."""

    def __init__(
        self,
        seed: int,
        kind: str,
        *,
        travel: float,
        pitch: float = 0.0,
        arm: float = 0.3,
        pairs: int = 20,
        frames: int = 200,
        oriented: bool = True,
    ) -> None:
        rng = np.random.default_rng(seed)
        self.q = swept(rng, kind, pairs, frames, travel)
        self.T_parent_axis = poses(
            Rotation.random(pairs, random_state=rng).as_rotvec(), rng.uniform(-0.5, 0.5, (pairs, 3))
        )
        self.T_axis_child = poses(Rotation.random(pairs, random_state=rng).as_rotvec(), np.array([arm, 0.0, 0.0]))
        T = self.T_parent_axis[:, None] @ motion(kind, self.q, pitch) @ self.T_axis_child[:, None]
        noise = rng.normal(size=(pairs, frames, 6))
        self.measured = T @ poses(SIGMA_RAD * noise[..., 3:], SIGMA_M * noise[..., :3])
        if not oriented:
            self.measured[..., :3, :3] = np.eye(3)
        self.oriented = np.full((pairs, frames), oriented)

    @property
    def tracks(self) -> PairTracks:
        one = np.ones(len(self.measured), dtype=bool)
        noise = unknown_noise(self.measured, ~one, one)
        return PairTracks(self.measured, np.ones_like(self.oriented), self.oriented, noise, np.ones(len(self.measured)))

    def fit(self, kind: str) -> JointFit:
        return fit_joint(JOINT_TYPES[kind], self.tracks, by_pose=bool(self.oriented.all()))

    def axis_error(self, fit: JointFit) -> FloatArray:
        a, b = fit.model.frames.T_parent_axis[:, :3, 2], self.T_parent_axis[:, :3, 2]
        return np.arctan2(np.linalg.norm(np.cross(a, b), axis=-1), np.abs(np.sum(a * b, axis=-1)))

    def centre_error(self, fit: JointFit) -> FloatArray:
        return np.linalg.norm(fit.model.frames.T_parent_axis[:, :3, 3] - self.T_parent_axis[:, :3, 3], axis=-1)


def deviation(fit: JointFit, *columns: int) -> FloatArray:
    """(P,) square root of the summed variances of some parameters."""
    variance = np.diagonal(parameter_covariance(fit.information), axis1=-2, axis2=-1)
    return np.sqrt(variance[:, list(columns)].sum(axis=-1))


def bound(kind: str, made: Made, pitch: float, wanted: str) -> float:
    """Cramer-Rao bound of the first pair's pitch, or centre, by finite differences of the definition.

    Parameters: a right perturbation of T_parent_axis, one of T_axis_child, the pitch; then each frame's states. The
    pseudo-inverse leaves out what only moves the zero.
    """
    F, C, q, step = made.T_parent_axis[0], made.T_axis_child[0], made.q[0], 1e-5
    T = F @ motion(kind, q, pitch) @ C

    def errors(moved: FloatArray) -> FloatArray:
        between = np.linalg.inv(T) @ moved
        w = Rotation.from_matrix(between[:, :3, :3]).as_rotvec()
        return np.concatenate([between[:, :3, 3] / SIGMA_M, w / SIGMA_RAD], axis=-1) / step

    small = step * np.eye(6)
    columns = [errors(F @ poses(d[3:], d[:3]) @ motion(kind, q, pitch) @ C).ravel() for d in small]
    columns += [errors(F @ motion(kind, q, pitch) @ C @ poses(d[3:], d[:3])).ravel() for d in small]
    columns.append(errors(F @ motion(kind, q, pitch + step) @ C).ravel())
    each = q.reshape(len(q), -1)
    for t, i in np.ndindex(each.shape):
        dq = np.zeros_like(each)
        dq[t, i] = step
        columns.append(errors(F @ motion(kind, (each + dq).reshape(q.shape), pitch) @ C).ravel())
    J = np.stack(columns, axis=-1)
    if kind == "spherical":
        J = np.delete(J, 12, axis=1)  # it has no pitch
    scale = np.linalg.norm(J, axis=0) + 1e-300
    variance = np.diagonal(np.linalg.pinv((J / scale).T @ (J / scale), rcond=1e-9)) / scale**2
    return float(np.sqrt(variance[12] if wanted == "pitch" else variance[:3].sum()))


def test_the_deviation_of_a_pitch_is_the_bound() -> None:
    made = Made(0, "screw", travel=2.0, pitch=0.03, pairs=1, frames=60)
    fit = made.fit("screw")
    noise = np.sqrt(fit.model.scales[0] / np.array([SIGMA_M, SIGMA_RAD]) ** 2)  # it knows the noise to some per cent
    assert deviation(fit, 9)[0] == pytest.approx(bound("screw", made, 0.03, "pitch"), rel=0.1 * noise.max())


def test_the_deviation_of_a_centre_is_the_bound() -> None:
    made = Made(1, "spherical", travel=1.0, pairs=1, frames=40)
    assert deviation(made.fit("spherical"), 0, 1, 2)[0] == pytest.approx(
        bound("spherical", made, 0.0, "point"), rel=0.1
    )


@pytest.mark.parametrize(
    ("travel", "pitch", "arm"),
    [(1.0, 0.05, 0.3), (19.0, 0.002, 0.1), (19.0, 0.02, 0.0), (0.5, 0.5, 0.3), (60.0, 0.001, 0.05)],
)
def test_errors_of_screws_are_as_large_as_their_deviations_say(travel: float, pitch: float, arm: float) -> None:
    made = Made(2, "screw", travel=travel, pitch=pitch, arm=arm, pairs=40)
    fit = made.fit("screw")
    of_axis = np.mean((made.axis_error(fit) / deviation(fit, 2, 3)) ** 2)
    of_pitch = np.mean(((fit.model.frames.form[:, 0] - pitch) / deviation(fit, 9)) ** 2)
    assert 0.6 < of_axis < 1.5  # chi squared of 80 degrees of freedom over 80, beyond 99 %
    assert 0.5 < of_pitch < 1.75  # of 40


@pytest.mark.parametrize(("travel", "arm"), [(0.3, 0.3), (1.0, 0.3), (3.0, 0.3), (1.5, 0.05)])
def test_errors_of_balls_are_as_large_as_their_deviations_say(travel: float, arm: float) -> None:
    made = Made(3, "spherical", travel=travel, arm=arm, pairs=40)
    fit = made.fit("spherical")
    ratio = np.mean((made.centre_error(fit) / deviation(fit, 0, 1, 2)) ** 2)
    assert 0.65 < ratio < 1.4  # chi squared of 120 degrees of freedom over 120, beyond 99 %


@pytest.mark.parametrize(("pitch", "noise_of_pitch"), [(0.002, 1.5), (0.0003, 10.0)])
def test_states_of_a_screw_count_on_over_turns_despite_outliers_and_gaps(pitch: float, noise_of_pitch: float) -> None:
    """By the advance where a turn of it is more than noise, else from frame to frame."""
    assert pytest.approx(noise_of_pitch) == SIGMA_M / pitch
    made = Made(4, "screw", travel=19.0, pitch=pitch, arm=0.1, frames=300)
    rng = np.random.default_rng(4)
    wrong = rng.uniform(size=made.q.shape) < 0.15
    made.measured[wrong] = made.measured[wrong] @ poses(
        rng.normal(size=(wrong.sum(), 3)), 0.2 * rng.normal(size=(wrong.sum(), 3))
    )
    tracks = made.tracks
    seen = rng.uniform(size=made.q.shape) > 0.2
    measured = np.where(seen[..., None, None], made.measured, np.eye(4))
    one = np.ones(len(measured), dtype=bool)
    tracks = PairTracks(measured, seen, seen, unknown_noise(measured, ~one, one), np.ones(len(measured)))
    fit = fit_joint(JOINT_TYPES["screw"], tracks, by_pose=True)
    sign = np.sign(np.sum(fit.model.frames.T_parent_axis[:, :3, 2] * made.T_parent_axis[:, :3, 2], axis=-1))
    off = np.rint((sign[:, None] * fit.model.q[..., 0] - made.q) / (2 * np.pi))
    usual = np.median(off, axis=1, keepdims=True)  # as many turns off throughout is another zero
    good = seen & ~wrong
    assert np.mean((off == usual)[good]) > 0.99
    assert np.median(np.abs(fit.model.frames.form[:, 0] / pitch - 1)) < 0.3


@pytest.mark.parametrize(("travel", "pitch", "arm"), [(19.0, 0.002, 0.1), (6.3, 0.01, 0.03), (3.0, 0.1, 0.2)])
def test_positions_alone_tell_a_helix(travel: float, pitch: float, arm: float) -> None:
    made = Made(5, "screw", travel=travel, pitch=pitch, arm=arm, pairs=5, oriented=False)
    fit = made.fit("screw")
    assert np.degrees(np.median(made.axis_error(fit))) < 1.5
    assert np.median(np.abs(fit.model.frames.form[:, 0] / pitch - 1)) < 0.05


def test_positions_alone_tell_the_centre_of_a_ball() -> None:
    made = Made(6, "spherical", travel=1.0, oriented=False)
    assert np.median(made.centre_error(made.fit("spherical"))) < 0.006  # m: 3 mm over 200 points of a cap of 29 deg


def called(made: Made, candidates: tuple[str, ...] = ALL) -> Counter[str]:
    tracks = made.tracks
    scores = score_fits(fit_types(tracks, candidates, quickly=True), tracks, "evidence")
    return Counter(scores.best_type(pair) for pair in range(len(made.q)))


@pytest.mark.parametrize(
    ("kind", "travel", "pitch", "arm"),
    [("rigid", 0.0, 0.0, 0.3), ("prismatic", 0.2, 0.0, 0.3), ("revolute", 1.5, 0.0, 0.3), ("revolute", 5.0, 0.0, 0.3),
     ("screw", 1.0, 0.03, 0.3), ("screw", 19.0, 0.002, 0.1), ("screw", 0.5, 0.5, 0.1), ("spherical", 1.0, 0.0, 0.3)],
)  # fmt: skip
def test_clear_motions_are_called_by_their_type_among_all_five(
    kind: str, travel: float, pitch: float, arm: float
) -> None:
    made = Made(7, kind, travel=travel, pitch=pitch, arm=arm, pairs=12)
    assert called(made)[kind] >= 11  # a pitch of nothing but noise is believed in one of a hundred


@pytest.mark.parametrize("travel", [1.5, 12.0, 60.0])
def test_a_hinge_that_turned_several_times_is_no_screw(travel: float) -> None:
    """Both count the same turns: with fewer, a screw would seem to know its states better."""
    made = Made(8, "revolute", travel=travel, pairs=20, frames=300)
    assert called(made, ("revolute", "screw"))["revolute"] >= 18


def test_a_tree_of_a_screw_and_a_ball_is_learned_and_moves_as_it_did() -> None:
    rng, t = np.random.default_rng(8), np.linspace(0, 10, 300)
    bolt, stick = (poses(rng.normal(size=3), rng.uniform(-0.2, 0.2, 3)) for _ in range(2))
    turns = 12 * np.sin(0.6 * t)
    swing = 0.6 * np.stack([np.sin(t), np.sin(1.7 * t + 1), np.sin(2.3 * t)], axis=-1)
    T_world_part = np.stack(
        [
            np.tile(poses(rng.normal(size=3), np.zeros(3)), (300, 1, 1)),
            bolt @ motion("screw", turns, 0.01) @ poses(np.zeros(3), np.array([0.05, 0, 0.1])),
            stick @ motion("spherical", swing) @ poses(np.zeros(3), np.array([0.0, 0.05, 0.2])),
        ],
        axis=1,
    )
    noise = rng.normal(size=(300, 3, 6))
    measured = T_world_part @ poses(0.01 * noise[..., 3:], 0.001 * noise[..., :3])
    fit = learn(PoseLog(t, "world", ("base", "nut", "stick"), measured), FitOptions(joint_types=ALL, root="base"))
    assert {joint.child: joint.type for joint in fit.tree.joints} == {"nut": "screw", "stick": "spherical"}
    assert fit.states.joints == fit.tree.columns
    nut, ball = (fit.tree.joint(f"base__{part}") for part in ("nut", "stick"))
    assert nut.pitch_m_per_rad == pytest.approx(0.01, rel=0.01)
    centre = np.linalg.inv(T_world_part[0, 0]) @ stick
    np.testing.assert_allclose(ball.point_parent_m, centre[:3, 3], atol=0.001)  # m
    learned = fit.tree.forward(fit.states.q)
    for part, name in enumerate(("base", "nut", "stick")):
        between = np.linalg.inv(learned[name]) @ np.linalg.inv(measured[:, :1])[:, 0] @ measured[:, part]
        off = np.linalg.norm(between[:, :3, 3], axis=-1)
        assert np.sqrt(np.mean(off**2)) < 0.006  # m: noise of both parts, the base's orientation over 0.3 m
    assert np.ptp(fit.states.state("base__nut")) == pytest.approx(np.ptp(turns), abs=0.05)
