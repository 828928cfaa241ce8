"""Stated 95 % regions hold the truth about as often as they say, for each joint type, alone and in trees.

Axes, points, pitches and mounts by their covariances; states frame by frame, after the one constant that the choice of
zero leaves free is taken out with the weights of their covariances. Fits start at the truth: the search is not at test.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass, field

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2, norm
from true_trees import measured_of, true_tree

from station.fit.skeleton import Skeleton, TreeModel
from station.fit.whole_tree import TreeFit, refine_tree
from station.kinematics import se3
from station.logs import FloatArray
from tests.benchmarks.made_joints import SOUND, Faults, MadeObject, single_joint, watch
from tests.benchmarks.made_trees import random_tree

FITS, TREES, FRAMES = 50, 24, 80
STD_M, STD_RAD = 0.003, 0.02
LEVEL = 0.95
TRAVEL = {"prismatic": 0.2, "revolute": 1.2, "screw": 3.0, "spherical": 1.0}  # m, rad
POSITIONS_TRAVEL = {**TRAVEL, "revolute": 3.0, "screw": 5.0}


@dataclass
class Tally:
    """Squared errors over their covariances with degrees of freedom, by what they are of; shares of states inside."""

    squares: dict[str, list[tuple[float, int]]] = field(default_factory=lambda: defaultdict(list))
    states: dict[str, list[float]] = field(default_factory=lambda: defaultdict(list))

    def add(self, what: str, error: FloatArray, covariance: FloatArray) -> None:
        self.squares[what].append((float(error @ np.linalg.solve(covariance, error)), len(error)))

    def check(self) -> None:
        """Binomial: of 50 fits at 95 %, 42 or more are inside in all but one of 1300 tallies."""
        for what, found in self.squares.items():
            square, freedoms = np.array(found).T
            inside = np.mean(square < chi2.ppf(LEVEL, freedoms))
            slack = 3.7 * np.sqrt(LEVEL * (1 - LEVEL) / len(square))
            assert inside > LEVEL - slack, f"{what}: {inside:.3f} of {len(square)} inside"
            error = 3.7 * np.sqrt(2 * np.mean(1 / freedoms) / len(square))
            assert abs(np.mean(square / freedoms) - 1) < error + 0.1, f"{what}: {np.mean(square / freedoms):.2f}"
        for what, shares in self.states.items():
            assert 0.93 < np.mean(shares) < 0.97, f"states of {what}: {np.mean(shares):.3f} inside"


def tally(tally: Tally, skeleton: Skeleton, true: TreeModel, fit: TreeFit) -> None:
    for j, joint in enumerate(skeleton.joints):
        kind, columns = joint.type, skeleton.joint_columns(j)
        covariance = fit.covariance[columns, columns]
        T = se3.inverse(fit.model.frames[j].T_parent_axis) @ true.frames[j].T_parent_axis
        at = {entry: i for i, entry in enumerate(kind.axis_freedoms)}
        slope = T[:2, 2] / T[2, 2]
        if kind.has_axis:
            tilt = [at[3], at[4]]  # a turn about x moves the axis along -y
            tally.add(f"{kind.name} axis", np.array([-slope[1], slope[0]]), covariance[np.ix_(tilt, tilt)])
        if kind.has_point:
            foot = T[:2, 3] - T[2, 3] * slope if kind.has_axis else T[:3, 3]
            place = [at[i] for i in range(len(foot))]
            tally.add(f"{kind.name} point", foot, covariance[np.ix_(place, place)])
        if kind.form_freedoms:
            tally.add(f"{kind.name} form", fit.model.frames[j].form - true.frames[j].form, covariance[-1:, -1:])
        q, q_true = (model.q[:, skeleton.state_columns(j)] for model in (fit.model, true))
        if np.all(np.isfinite(fit.state_covariance[j])):
            seen = [
                fit.inlier[:, np.equal(skeleton.body_of, b)].max(axis=1, initial=0.0) > 0.5
                for b in (joint.far, joint.near)
            ]
            good = seen[0] & (seen[1] | (not skeleton.root_moves and joint.near == 0))
            tally.states[kind.name].append(states_inside(q[good], q_true[good], fit.state_covariance[j][good]))
    for k in np.flatnonzero(skeleton.free_mount).tolist():
        columns = skeleton.mount_columns(k)
        tally.add("mount", se3.log(se3.inverse(true.mounts[k]) @ fit.model.mounts[k]), fit.covariance[columns, columns])


def states_inside(q: FloatArray, true: FloatArray, covariance: FloatArray) -> float:
    """Share of states (T, s) in their intervals; rotation vectors differ by the rotation between them."""
    error = q - true
    if q.shape[-1] == 3:
        error = (Rotation.from_rotvec(true).inv() * Rotation.from_rotvec(q)).as_rotvec()
    information = np.linalg.inv(covariance)
    of_mean = np.linalg.inv(information.sum(axis=0))
    error = error - of_mean @ np.einsum("tij,tj->i", information, error)
    variance = np.diagonal(covariance - of_mean, axis1=-2, axis2=-1)
    return float(np.mean(np.abs(error) < norm.ppf(0.5 + LEVEL / 2) * np.sqrt(variance)))


def fitted(
    rng: np.random.Generator, made: MadeObject, faults: Faults, wrong: float
) -> tuple[Skeleton, TreeModel, TreeFit]:
    """Deviations are said to be `wrong` times what they are."""
    skeleton, true = true_tree(made)
    log = watch(rng, made.T_ref_part, STD_M, STD_RAD, faults).log
    return skeleton, true, refine_tree(skeleton, true, measured_of(log, wrong * STD_M, wrong * STD_RAD).of_parts)


@pytest.mark.parametrize("positions_only", [False, True])
@pytest.mark.parametrize("kind", list(TRAVEL))
def test_regions_of_single_joints_hold_the_truth(kind: str, positions_only: bool) -> None:
    """Every second log misses a fifth of the poses."""
    found = Tally()
    travel = (POSITIONS_TRAVEL if positions_only else TRAVEL)[kind]
    for fit in range(FITS):
        rng = np.random.default_rng([70, list(TRAVEL).index(kind), positions_only, fit])
        made = single_joint(rng, kind, frames=FRAMES, travel=travel, arm_m=rng.uniform(0.2, 0.4))
        faults = Faults(missing=0.2 * (fit % 2), positions_only=positions_only)
        tally(found, *fitted(rng, made, faults, 1.0))
    found.check()


@pytest.mark.parametrize("root_moves", [False, True])
def test_regions_inside_trees_hold_the_truth(root_moves: bool) -> None:
    """Every second log misses a fifth of the poses; with others the noise is said to be half or twice what it is."""
    found = Tally()
    for fit in range(TREES):
        rng = np.random.default_rng([71, root_moves, fit])
        kinds = list(TRAVEL)
        made = random_tree(
            rng, bodies=4, frames=FRAMES, kinds=kinds, root_moves=root_moves, walk=fit % 3 == 0, trackers=(1, 2)
        )
        tally(found, *fitted(rng, made, Faults(missing=0.2 * (fit % 2)), (1.0, 2.0, 0.5)[fit % 3]))
    found.check()


def test_states_of_short_logs_deviate_as_said_but_for_one_constant() -> None:
    """Of twelve frames: a tenth larger if the error of zero were in them, a tenth smaller without that of the axis."""
    ratios = []
    for fit in range(160):
        rng = np.random.default_rng([72, fit])
        made = single_joint(rng, "revolute", frames=12, travel=1.2, arm_m=0.3)
        _, true, found = fitted(rng, made, SOUND, 1.0)
        error, variance = (found.model.q - true.q)[:, 0], found.state_covariance[0][:, 0, 0]
        of_mean = 1 / np.sum(1 / variance)
        error -= of_mean * np.sum(error / variance)
        ratios.append(np.mean(error**2 / (variance - of_mean)))
    assert 0.9 < np.mean(ratios) < 1.15  # 0.03 is chance
