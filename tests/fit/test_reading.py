"""Reading a joint: sign, zero and point are definite, the motion stays, deviations are those of the columns."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from station.fit.learner import learn
from station.fit.options import FitOptions
from station.fit.reading import JointReading
from station.fit.selection import Scores
from station.kinematics import se3
from station.kinematics.joints import JOINT_TYPES, JointFrames
from station.kinematics.tree import Joint
from station.logs import FloatArray
from tests.benchmarks.made_joints import MadeObject, watch
from tests.benchmarks.made_trees import random_tree

FRAMES, FIRST, STEP = 30, 3, 1e-6
MOVABLE = [name for name in JOINT_TYPES if JOINT_TYPES[name].states]
ALL_TYPES = tuple(JOINT_TYPES)


def reading_of(kind: str, q: FloatArray | None = None, *, seed: int = 80) -> JointReading:
    """A joint anywhere with states that wind through a range; the first frames are not good."""
    rng, joint = np.random.default_rng(seed), JOINT_TYPES[kind]
    form = np.full(joint.form_freedoms, 0.02)
    frames = JointFrames(se3.exp(rng.normal(size=6)), se3.exp(rng.normal(size=6)), form)
    t = np.linspace(0, 1, FRAMES)[:, None]
    states = 0.5 * np.cos(3 * t + rng.uniform(0, 6, joint.states)) + 0.8 * t
    good = np.arange(FRAMES) >= FIRST
    root = rng.normal(size=(6 + len(form), 6 + len(form)))
    state_root = rng.normal(size=(FRAMES, joint.states, joint.states))
    return JointReading(
        type=joint,
        frames=frames,
        covariance=root @ root.T,
        q=states if q is None else q,
        state_covariance=state_root @ np.swapaxes(state_root, -1, -2),
        seen=np.ones(FRAMES, dtype=bool),
        good=good,
        residual=np.zeros((FRAMES, 6)),
        placed=good,
        oriented=good,
        spread=np.ones(2),
    )


def poses(reading: JointReading) -> FloatArray:
    f = reading.frames
    return f.T_parent_axis @ reading.type.axis_motion(reading.q, f.form) @ f.T_axis_child


@pytest.mark.parametrize("kind", ALL_TYPES)
def test_a_settled_joint_moves_as_before(kind: str) -> None:
    reading = reading_of(kind)
    settled = reading.settled()
    np.testing.assert_allclose(poses(settled)[FIRST:], poses(reading)[FIRST:], atol=1e-12)
    assert np.all(np.isnan(settled.q[:FIRST]))
    np.testing.assert_allclose(settled.q[FIRST], 0.0, atol=1e-12)


@pytest.mark.parametrize("kind", [name for name in MOVABLE if JOINT_TYPES[name].has_axis])
def test_states_grow_over_the_motion_and_the_point_is_beside_the_child(kind: str) -> None:
    for reading in (reading_of(kind), replace(reading_of(kind), q=-reading_of(kind).q)):
        settled = reading.settled()
        assert settled.q[-1, 0] > 0
        if settled.type.has_point:
            T_axis_child = se3.inverse(settled.frames.T_parent_axis) @ poses(settled)[FIRST:]
            assert np.mean(T_axis_child[:, 2, 3]) == pytest.approx(0.0, abs=1e-12)


def test_a_spherical_joint_is_read_in_the_parent_s_axes() -> None:
    settled = reading_of("spherical").settled()
    np.testing.assert_allclose(settled.frames.T_parent_axis[:3, :3], np.eye(3), atol=1e-12)


@pytest.mark.parametrize("kind", MOVABLE)
def test_deviations_of_states_are_those_of_the_columns(kind: str) -> None:
    """By finite differences: states moved one at a time in a frame, read anew, and held against those before."""
    reading = reading_of(kind)
    settled = reading.settled()
    row, joint = 20, reading.type
    changes = []
    for step in STEP * np.eye(joint.states):
        q = reading.q.copy()
        q[row] = joint.moved(q[row], step)
        changes.append((replace(reading, q=q).settled().q[row] - settled.q[row]) / STEP)
    J = np.stack(changes, axis=-1)
    expected = np.sqrt(np.diagonal(J @ reading.state_covariance[row] @ J.T))
    np.testing.assert_allclose(settled.std[row], expected, rtol=1e-5)


@pytest.mark.parametrize("kind", ALL_TYPES)
def test_the_covariance_of_axis_and_point_moves_with_their_frame(kind: str) -> None:
    """An error of the frame before is the one after, told along its own axes."""
    reading = reading_of(kind)
    settled = reading.settled()
    values, vectors = np.linalg.eigh(reading.covariance[:6, :6])
    between = se3.inverse(settled.frames.T_parent_axis) @ reading.frames.T_parent_axis
    moved = np.stack([se3.log(between @ se3.exp(STEP * v) @ se3.inverse(between)) / STEP for v in vectors.T], axis=-1)
    np.testing.assert_allclose(settled.covariance[:6, :6], (moved * values) @ moved.T, rtol=1e-4, atol=1e-4)


def test_std_of_a_joint_counts_the_directions_that_it_has() -> None:
    """Two of an axis and two of its point across it; three of a ball's centre."""
    variance = {"revolute": (1 + 2, 8 + 16), "screw": (1 + 2, 8 + 16), "spherical": (1 + 2 + 4, None)}
    for kind, (point, axis) in variance.items():
        covariance = np.diag([1.0, 2.0, 4.0, 8.0, 16.0, 32.0, *np.full(JOINT_TYPES[kind].form_freedoms, 0.25)])
        joint = joint_of(replace(reading_of(kind).settled(), covariance=covariance))
        assert joint.point_std_m == pytest.approx(np.sqrt(point))
        assert joint.axis_std_rad == (None if axis is None else pytest.approx(np.sqrt(axis)))
        assert joint.pitch_std_m_per_rad == (0.5 if kind == "screw" else None)


def joint_of(reading: JointReading) -> Joint:
    none = np.zeros(1)
    scores = Scores("evidence", {reading.type.name: none}, none, none, none > 0, none)
    return reading.joint("a", "b", scores, 0)


@pytest.mark.parametrize("root_moves", [False, True])
def test_any_root_gives_the_same_motion_with_all_joint_types(root_moves: bool) -> None:
    """Forward kinematics from the chosen root against the truth, also where joints hang the other way round inside."""
    rng = np.random.default_rng(81)
    kinds = ["spherical", "screw", "revolute"]
    made = random_tree(rng, bodies=4, frames=120, kinds=kinds, root_moves=root_moves, walk=False, trackers=(1, 2))
    log = watch(rng, made.T_ref_part, 1e-3, 0.005).log
    log = replace(log, parts=made.parts)
    for body in (0, 3):
        root = made.parts[made.body_of.index(body)]
        fit = learn(log, FitOptions(joint_types=ALL_TYPES, root=root))
        assert len(fit.tree.joints) == 3
        T_root = fit.tree.forward(fit.states.q)
        start = made.T_ref_part[:, made.parts.index(fit.tree.root)]
        for part, T in T_root.items():
            error = se3.log(se3.inverse(se3.inverse(start) @ made.T_ref_part[:, made.parts.index(part)]) @ T)
            assert np.sqrt(np.nanmean(error[:, 3:] ** 2)) < 0.01  # rad; two or three joints' errors of 0.005 each
            assert np.sqrt(np.nanmean(error[:, :3] ** 2)) < 0.005  # m


@pytest.mark.parametrize("hidden", [1, 2])
def test_a_joint_has_no_state_where_one_of_its_bodies_was_not_seen_and_others_have(hidden: int) -> None:
    """Of a chain of four. With the second body hidden the third still tells both its joints, but that is no reading."""
    rng = np.random.default_rng(82)
    made = chain(rng)
    log = replace(watch(rng, made.T_ref_part, 1e-3, 0.005).log, parts=made.parts)
    T = log.T_ref_part.copy()
    T[40:50, hidden] = np.nan
    fit = learn(replace(log, T_ref_part=T), FitOptions(root=made.parts[0]))
    assert len(fit.tree.joints) == 3
    for column, joint in enumerate(fit.tree.joints):
        expected = np.zeros(120, dtype=bool)
        expected[40:50] = made.parts[hidden] in (joint.parent, joint.child)
        np.testing.assert_array_equal(np.isnan(fit.states.q[:, column]), expected)


def chain(rng: np.random.Generator) -> MadeObject:
    """Four bodies in a row, a tracker each, hinges between them; the first stands still."""
    while True:
        made = random_tree(rng, bodies=4, frames=120, kinds=["revolute"], root_moves=False, walk=False, trackers=(1, 1))
        if [joint.parent for joint in made.joints] == [0, 1, 2]:
            order = [made.body_of.index(body) for body in range(4)]
            return replace(made, body_of=(0, 1, 2, 3), T_body_part=made.T_body_part[order])
