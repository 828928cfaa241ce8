"""What each place costs in which the paper can't be followed to the letter: measurements, no figures.

Numbered as in docs/paper_and_station.md. All data are simulated from the definitions; all randomness is seeded.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse.csgraph import minimum_spanning_tree

from station.fit.learner import learn
from station.fit.paper import PaperSteps, Weights, low_pass, unsmoothed, weighted_cost
from station.fit.paper.cost import Cost
from station.fit.paper.joints import PaperPrismatic, PaperRevolute
from station.fit.paper.matching import Match, match_joints
from station.fit.paper.optimiser import bfgs, one_by_one
from station.fit.paper.starts import start_revolute
from station.fit.paper.steps import spanning_tree
from station.formats.legacy_aruco import rotation_of_angles
from station.kinematics import metric, se3
from station.kinematics.joints import JOINT_TYPES
from station.logs import FloatArray, PoseLog
from tests.fit.simulated import poses, states

TYPES = ("rigid", "prismatic", "revolute")
# Noise per axis of the relative poses.
SIGMA_RAD, SIGMA_M = np.radians(1.0), 0.002
WEIGHTS = Weights.of_noise(SIGMA_RAD, SIGMA_M)
COST = weighted_cost(WEIGHTS)
FRAMES = 100


def random_poses(rng: np.random.Generator, *batch: int) -> FloatArray:
    """Some 50 deg and 0.15 m from the identity."""
    return poses(0.5 * rng.normal(size=(*batch, 3)), 0.1 * rng.normal(size=(*batch, 3)))


def noise(rng: np.random.Generator, frames: int) -> FloatArray:
    """(T, 4, 4) right perturbations."""
    return poses(SIGMA_RAD * rng.normal(size=(frames, 3)), SIGMA_M * rng.normal(size=(frames, 3)))


def hinge(rng: np.random.Generator, radius_m: float, travel_rad: float, frames: int) -> tuple[FloatArray, FloatArray]:
    """(T, 4, 4) exact poses of a child that turns about an axis of its parent, and the axis (3,)."""
    axis = rng.normal(size=3)
    axis /= np.linalg.norm(axis)
    across = np.cross(axis, rng.normal(size=3))
    turn = states(rng, frames, travel_rad, "smooth")[:, None] * axis
    zero = poses(rng.normal(size=3), radius_m * across / np.linalg.norm(across))
    point = poses(np.zeros(3), rng.uniform(-0.2, 0.2, 3))
    return point @ poses(turn, np.zeros((frames, 3))) @ zero, axis


def angle_deg(a: FloatArray, b: FloatArray) -> float:
    """Between two lines."""
    return float(np.degrees(np.arctan2(np.linalg.norm(np.cross(a, b)), abs(a @ b))))


@dataclass(frozen=True, eq=False)
class Invariance:
    """1: distances of pairs of poses that both moved, over those before.

    `left` and `turned` are the largest departures from 1, of motions on the left and of rotations on the right;
    `shifted` (L, N) the ratios for translations on the right by `lengths_m` (L,).
    """

    left: float
    turned: float
    lengths_m: FloatArray
    shifted: FloatArray


def invariance(seed: int, pairs: int = 400) -> Invariance:
    """The metric (15) under motions on the left and on the right."""
    rng = np.random.default_rng(seed)
    u, v, g = random_poses(rng, 3, pairs)

    def ratio(T_u: FloatArray, T_v: FloatArray) -> FloatArray:
        return metric.distance(T_u, T_v, c=WEIGHTS.c, d=WEIGHTS.d) / metric.distance(u, v, c=WEIGHTS.c, d=WEIGHTS.d)

    turn = se3.pose(g[:, :3, :3], np.zeros(3))
    lengths_m = np.geomspace(0.003, 1.0, 30)
    ways = rng.normal(size=(pairs, 3))
    ways /= np.linalg.norm(ways, axis=-1, keepdims=True)
    shifted = [ratio(u @ se3.translation(x * ways), v @ se3.translation(x * ways)) for x in lengths_m]
    return Invariance(
        left=float(np.abs(ratio(g @ u, g @ v) - 1).max()),
        turned=float(np.abs(ratio(u @ turn, v @ turn) - 1).max()),
        lengths_m=lengths_m,
        shifted=np.array(shifted),
    )


@dataclass(frozen=True, eq=False)
class Gradients:
    """2: rotation gradients (N, 3) of (16) with c = 1 along rotations of U: finite differences, corrected, printed."""

    numeric: FloatArray
    corrected: FloatArray
    printed: FloatArray

    def misdirection_deg(self, found: FloatArray) -> FloatArray:
        """(N,) angles to the finite difference."""
        dot = (found * self.numeric).sum(axis=-1)
        return np.degrees(np.arctan2(np.linalg.norm(np.cross(found, self.numeric), axis=-1), dot))


def gradients(seed: int, pairs: int = 300) -> Gradients:
    """Central differences of the matrix logarithm's norm against (17) as printed and as corrected."""
    rng = np.random.default_rng(seed)
    U, V = (poses(rng.normal(size=(pairs, 3)), np.zeros((pairs, 3))) for _ in range(2))
    step = 1e-6  # rad

    def value(T: FloatArray) -> FloatArray:
        return metric.squared_distance(T, V, c=1.0, d=1.0)

    turns = [se3.pose(se3.exp_so3(step * e), np.zeros(3)) for e in np.eye(3)]
    numeric = np.stack([(value(U @ T) - value(U @ se3.inverse(T))) / (2 * step) for T in turns], axis=-1)
    R, S = U[:, :3, :3], V[:, :3, :3]
    U_t_V = np.swapaxes(R, -1, -2) @ S
    printed = 2 * se3.hat3(se3.log_so3(U_t_V)) @ np.swapaxes(S, -1, -2) @ R @ S
    along = np.stack([np.einsum("nij,nij->n", printed, R @ se3.hat3(e)) for e in np.eye(3)], axis=-1)
    return Gradients(numeric, metric.twist_gradient(U, V, c=1.0, d=1.0)[:, 3:], along)


def fitted(start: PaperRevolute, x: FloatArray, cost: Cost) -> PaperRevolute:
    """The joint with the least cost, by BFGS."""
    joint = one_by_one(bfgs)(PaperRevolute.batch([start]), x[None], cost)
    return PaperRevolute(*joint.take(0).arrays)


def conventions(seed: int) -> dict[str, tuple[float, float]]:
    """3: residual rms [deg, mm] of the best hinge of exact poses, by both formulas of the relative pose."""
    rng = np.random.default_rng(seed)
    x, _ = hinge(rng, 0.3, np.radians(60.0), FRAMES)
    sway = np.stack([states(rng, FRAMES, 0.2, "smooth") for _ in range(6)], axis=-1)
    x_a = poses(2 * sway[:, 3:], sway[:, :3])
    x_b = x_a @ x
    found: dict[str, tuple[float, float]] = {}
    for name, delta in (("(x^a)^-1 x^b", se3.inverse(x_a) @ x_b), ("x^b (x^a)^-1", x_b @ se3.inverse(x_a))):
        joint = fitted(start_revolute(delta, rng), delta, COST)
        off = se3.inverse(joint.fk(joint.ik(delta))) @ delta
        turn, shift = se3.angle(off[:, :3, :3]), np.linalg.norm(off[:, :3, 3], axis=-1)
        found[name] = float(np.degrees(np.sqrt(np.mean(turn**2)))), float(1e3 * np.sqrt(np.mean(shift**2)))
    return found


@dataclass(frozen=True, eq=False)
class Starts:
    """4: by the child's distance from the axis and by kind of start (`START_KINDS`), over N trials under noise.

    Attributes:
        radii_m: (R,).
        at_start: (R, S, N) axis errors [deg].
        at_end: (R, S, N) after the optimiser.
        evaluations: (R, S, N) of the cost.
        exact: (S, N) -2 log likelihood a frame that the start leaves of exact poses at 0.3 m.
    """

    radii_m: FloatArray
    at_start: FloatArray
    at_end: FloatArray
    evaluations: FloatArray
    exact: FloatArray


RADII_M = (0.0, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.4)
START_KINDS = ("circumcentre in r", "circumcentre in c, as printed", "axis by the rotations")


def starts(seed: int, trials: int) -> Starts:
    """Hinges of 60 deg, each fitted from every kind of start."""
    found = np.array(
        [
            [_from_starts(np.random.default_rng([seed, k, i]), radius_m) for i in range(trials)]
            for k, radius_m in enumerate(RADII_M)
        ]
    )  # (R, N, S, 3)
    exact = [_left_of_exact(np.random.default_rng([seed, i])) for i in range(trials)]
    return Starts(np.array(RADII_M), *np.moveaxis(found, (1, 3), (3, 0)), np.array(exact).T)


def revolute_starts(x: FloatArray, rng: np.random.Generator) -> tuple[PaperRevolute, ...]:
    """A start of each of `START_KINDS`."""
    corrected = start_revolute(x, rng)
    i = int(np.argmin(np.abs(corrected.ik(x))))
    frames = JOINT_TYPES["revolute"].starts(x, np.ones(len(x)))[0]
    return (
        corrected,
        PaperRevolute(x[i] @ se3.inverse(corrected.r), corrected.r),
        PaperRevolute(frames.T_parent_axis, frames.T_axis_child),
    )


def _from_starts(rng: np.random.Generator, radius_m: float) -> list[tuple[float, float, int]]:
    """Axis error at the start and at the end, and evaluations, from each start."""
    x, axis = hinge(rng, radius_m, np.radians(60.0), FRAMES)
    x = x @ noise(rng, FRAMES)
    found: list[tuple[float, float, int]] = []
    for start in revolute_starts(x, rng):
        asked = 0

        def counted(T_model: FloatArray, T_measured: FloatArray) -> tuple[FloatArray, FloatArray]:
            nonlocal asked
            asked += 1
            return COST(T_model, T_measured)

        end = fitted(start, x, counted)
        found.append((angle_deg(start.r[:3, 2], axis), angle_deg(end.r[:3, 2], axis), asked))
    return found


def _left_of_exact(rng: np.random.Generator) -> list[float]:
    x, _ = hinge(rng, 0.3, np.radians(60.0), FRAMES)
    return [float(COST(joint.fk(joint.ik(x)), x)[0].mean()) for joint in revolute_starts(x, rng)]


def paper_match(x: FloatArray, rng: np.random.Generator) -> Match:
    """Algorithm 1 with the true noise for weights, no smoothing."""
    return match_joints(x[None], TYPES, PaperSteps(smoothing=unsmoothed, cost=COST), rng)[0]


def aic(costs: dict[str, float], *, overrated: float = 1.0, states_of: int = 0) -> str:
    """Type of lowest AIC, of costs with the true weights; with a parameter for each of `states_of` states if given.

    Noise overrated by a factor divides all costs by its square, and moves no minimum.
    """
    counts = {"rigid": 6, "prismatic": 7 + states_of, "revolute": 9 + states_of}
    k = counts if states_of else {"rigid": 6, "prismatic": 9, "revolute": 12}
    return min(TYPES, key=lambda name: costs[name] / overrated**2 + 2 * k[name])


@dataclass(frozen=True, eq=False)
class RigidRates:
    """5: share of rigid pairs called rigid (F,), by number of frames and method."""

    frames: tuple[int, ...]
    paper: FloatArray
    states_counted: FloatArray
    station: FloatArray


def rigid_rates(seed: int, trials: int, frames: Sequence[int]) -> RigidRates:
    """A part that stands still under noise, by the paper's AIC, by AIC that counts states, by the station."""
    rates = np.zeros((len(frames), 3))
    for k, count in enumerate(frames):
        for i in range(trials):
            rng = np.random.default_rng([seed, k, i])
            x = random_poses(rng) @ noise(rng, count)
            costs = dict(paper_match(x, rng).costs)
            by_station = not learn(PoseLog(np.arange(count) / 30, "camera", ("part",), x[:, None])).tree.joints
            rates[k] += [aic(costs) == "rigid", aic(costs, states_of=count) == "rigid", by_station]
    return RigidRates(tuple(frames), *(rates / trials).T)


@dataclass(frozen=True, eq=False)
class OverratedNoise:
    """5 and 6: share called rigid by the paper's AIC (C, F), by travel and by how far weights overrate the noise."""

    factors: FloatArray
    travels_deg: tuple[float, ...]
    rigid: FloatArray


def overrated_noise(seed: int, trials: int) -> OverratedNoise:
    """Hinges of 0.1 m that turn by little, or not at all."""
    factors, travels_deg = np.geomspace(0.5, 16, 41), (0.0, 5.0, 10.0, 20.0)
    rigid = np.zeros((len(travels_deg), len(factors)))
    for k, travel in enumerate(travels_deg):
        for i in range(trials):
            rng = np.random.default_rng([seed, k, i])
            x, _ = hinge(rng, 0.1, np.radians(travel), FRAMES)
            costs = dict(paper_match(x @ noise(rng, FRAMES), rng).costs)
            rigid[k] += [aic(costs, overrated=factor) == "rigid" for factor in factors]
    return OverratedNoise(factors, travels_deg, rigid / trials)


@dataclass(frozen=True, eq=False)
class Smoothed:
    """6: correlation of the noise (S, L) by lag in frames; error over claimed deviation (S,) of a rigid offset."""

    shares: tuple[float, ...]
    correlation: FloatArray
    ratio: FloatArray


def smoothed(seed: int, trials: int, lags: int = 30) -> Smoothed:
    """Rigid pairs before and after the low-pass filter.

    The offset's claimed deviation is that of independent frames: the residuals' deviation over the root of their
    number.
    """
    shares = (0.5, 0.2, 0.1, 0.05)
    correlation, ratio = np.zeros((len(shares), lags)), np.zeros(len(shares))
    for k, share in enumerate(shares):
        squares: list[float] = []
        for i in range(trials):
            rng = np.random.default_rng([seed, i])
            log = PoseLog(np.arange(300) / 30, "camera", ("a",), noise(rng, 300)[:, None])
            p = (log if share == 0.5 else low_pass(log, share)).T_ref_part[:, 0, :3, 3]
            off = p - p.mean(axis=0)
            correlation[k] += [np.mean(p[lag:] * p[: 300 - lag]) / np.mean(p**2) / trials for lag in range(lags)]
            squares += list(p.mean(axis=0) ** 2 / (off.var(axis=0) / 300))
        ratio[k] = np.sqrt(np.mean(squares))
    return Smoothed(shares, correlation, ratio)


def slide_errors(seed: int, trials: int) -> tuple[float, float]:
    """Rms errors [mm] of a slide's states, of the true joint, by (21) and by the child's position along the axis.

    The child is 0.3 m from the parent, at right angles to the slide.
    """
    squares = np.zeros((trials, 2))
    for i in range(trials):
        rng = np.random.default_rng([seed, i])
        u, across = np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.3, 0.0])
        q = states(rng, FRAMES, 0.2, "smooth")
        o = poses(rng.normal(size=3), across)
        x = poses(np.zeros((FRAMES, 3)), q[:, None] * u) @ o @ noise(rng, FRAMES)
        squares[i] = [np.mean((found - q) ** 2) for found in (PaperPrismatic(o, u).ik(x), (x[:, :3, 3] - across) @ u)]
    paper, ours = (1e3 * np.sqrt(squares.mean(axis=0))).tolist()
    return paper, ours


def angles_of_2013(seed: int, sizes_deg: Sequence[float], count: int = 2000) -> FloatArray:
    """7: median angle [deg] between (26) and the rotation of the same three numbers as a rotation vector, by length."""
    ways = np.random.default_rng(seed).normal(size=(count, 3))
    ways /= np.linalg.norm(ways, axis=-1, keepdims=True)
    off = [
        se3.angle(np.swapaxes(se3.exp_so3(size * ways), -1, -2) @ rotation_of_angles(size * ways))
        for size in np.radians(sizes_deg)
    ]
    return np.degrees(np.median(off, axis=-1))


def wrong_trees(seed: int, graphs: int = 200, nodes: int = 5) -> tuple[int, int]:
    """8: for how many complete graphs with one weight of zero the tree is not the lightest: by SciPy, by the station.

    The lightest is that of the weights one higher. SciPy's lacks no edge in such graphs: it takes a heavier one.
    """
    rng = np.random.default_rng(seed)
    pairs = np.stack(np.triu_indices(nodes, k=1), axis=-1)
    wrong = [0, 0]
    for _ in range(graphs):
        weights = rng.uniform(0, 100, len(pairs))
        weights -= weights.min()
        lightest = _scipy_tree(nodes, pairs, weights + 1)
        by_station = {(int(a), int(b)) for a, b in pairs[spanning_tree(nodes, pairs, weights)]}
        wrong[0] += _scipy_tree(nodes, pairs, weights) != lightest
        wrong[1] += by_station != lightest
    return wrong[0], wrong[1]


def _scipy_tree(nodes: int, pairs: np.ndarray, weights: FloatArray) -> set[tuple[int, int]]:
    graph = np.zeros((nodes, nodes))
    graph[tuple(pairs.T)] = weights
    return {(int(a), int(b)) for a, b in zip(*minimum_spanning_tree(graph).nonzero(), strict=True)}
