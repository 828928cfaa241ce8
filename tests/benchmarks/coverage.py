"""How often the stated 95 % regions hold the truth: axes, points and states, of single joints and inside trees.

100 frames, 3 mm and 0.02 rad for each axis, travels and arms at random. A fit states one number for the two directions
of an axis (or a point): the root of their variances' sum. Its region is the ellipse with the shape that the Cramer-Rao
bound has there and the size that was stated, at 95 % of chi squared of 2 degrees of freedom (3 for a spherical joint's
centre). States: each frame's own interval. The zero is arbitrary: the mean of the differences, weighted by the stated
variances, is taken out, and so is its variance from each frame's; of rotation vectors, the mean rotation. Wanted 93 to
97 %; what misses is marked <. `size` is the median of stated deviation over that of the bound. Fits of another type or
structure are counted and left out.

Run: python -m tests.benchmarks.coverage [--seed N] [--trials N] [--quick] [--only TEXT] [--workers N]
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.stats import chi2, norm

from station.fit.learner import Fit
from station.fit.options import FitOptions
from station.kinematics.joints import JOINT_TYPES
from station.kinematics.tree import Joint
from station.logs import FloatArray
from tests.benchmarks.arguments import each, parser, trials_of
from tests.benchmarks.bounds import Bound, bound
from tests.benchmarks.made_joints import Faults, MadeJoint, MadeObject, Watched, named, normals, single_joint, watch
from tests.benchmarks.made_trees import mistakes, random_tree
from tests.benchmarks.read_fits import DEFAULT_TYPES, attempt, candidates, found_type, states_of

FRAMES, STD_M, STD_RAD = 100, 0.003, 0.02
LEVEL = 0.95
WANTED = (0.93, 0.97)
TRAVELS = {"prismatic": (0.05, 0.3), "revolute": (0.5, 2.5), "screw": (1.0, 5.0), "spherical": (0.5, 1.5)}  # m, rad
# Positions alone tell less: shorter arcs than this [rad] are not always told from lines.
POSITION_TRAVELS = {**TRAVELS, "revolute": (1.5, 5.0), "screw": (4.0, 6.0)}
TREE_BODIES = 3


@dataclass(frozen=True)
class Told:
    """Of one joint: (inside, stated / bound) of axis and point, share of frames inside; NaN where it isn't stated."""

    axis: tuple[float, float]
    point: tuple[float, float]
    states: float


NOTHING = Told((np.nan, np.nan), (np.nan, np.nan), np.nan)


def try_single(job: tuple[str, bool, list[int]]) -> list[Told]:
    """One joint against the reference; empty if its type was not found."""
    kind, positions_only, seed = job
    rng = np.random.default_rng(seed)
    travel = rng.uniform(*(POSITION_TRAVELS if positions_only else TRAVELS)[kind])
    arm_m = rng.uniform(0.2 if positions_only else 0.0, 0.5)
    made = single_joint(rng, kind, frames=FRAMES, travel=travel, arm_m=arm_m)
    watched = watch(rng, made.T_ref_part, STD_M, STD_RAD, Faults(positions_only=positions_only))
    fit, _ = attempt(watched.log, FitOptions(joint_types=candidates(kind)))
    if fit is None or found_type(fit.tree) != kind:
        return []
    return [told(fit, fit.tree.joints[0], made, watched, 0, positions_only=positions_only)]


def try_tree(job: tuple[bool, list[int]]) -> list[Told]:
    """The joints of a random tree, told from the root that it was made with; empty if it was not found."""
    root_moves, seed = job
    rng = np.random.default_rng(seed)
    kinds = [name for name in DEFAULT_TYPES if name != "rigid"]
    walk = bool(seed[-1] % 2)
    made = random_tree(rng, bodies=TREE_BODIES, frames=FRAMES, kinds=kinds, root_moves=root_moves, walk=walk)
    watched = named(watch(rng, made.T_ref_part, STD_M, STD_RAD), made.parts)
    fit, _ = attempt(watched.log, FitOptions(root=made.parts[made.body_of.index(0)]))
    if fit is None or mistakes(fit.tree, made):
        return []
    found: list[Told] = []
    frames = [made.parts.index(name) for name in fit.tree.bodies]
    for joint in fit.tree.joints:
        ends = [made.body_of[made.parts.index(name)] for name in (joint.parent, joint.child)]
        j = next(i for i, true in enumerate(made.joints) if [true.parent, true.child] == ends)
        found.append(told(fit, joint, made, watched, j, frame_parts=frames))
    return found


def told(
    fit: Fit,
    joint: Joint,
    made: MadeObject,
    watched: Watched,
    j: int,
    *,
    positions_only: bool = False,
    frame_parts: list[int] | None = None,
) -> Told:
    """What a fitted joint says of the made object's joint j, which hangs from the same body."""
    truth = made.joints[j]
    T_body_part = np.eye(4) if frame_parts is None else made.T_body_part[made.parts.index(joint.parent)]
    point = None
    if joint.point_parent_m is not None:
        point = T_body_part[:3, :3] @ joint.point_parent_m + T_body_part[:3, 3]
        truth = at_foot(truth, point)
        made = replace(made, joints=(*made.joints[:j], truth, *made.joints[j + 1 :]))
    least = bound(made, watched.noise, STD_M, STD_RAD, positions_only=positions_only, frame_parts=frame_parts)
    axis = None if joint.axis_parent is None else T_body_part[:3, :3] @ joint.axis_parent
    sign = 1.0 if axis is None else float(np.sign(axis @ truth.axis))
    return Told(
        axis_told(axis, joint.axis_std_rad, truth, least, j),
        point_told(point, joint.point_std_m, truth, least, j),
        states_told(fit, joint, sign * made.q[j]),
    )


def at_foot(joint: MadeJoint, point: FloatArray) -> MadeJoint:
    """The same joint with the point of its axis that is nearest to `point` (3,); a spherical joint has but one."""
    if joint.type == "spherical":
        return joint
    return replace(joint, point_m=joint.point_m + joint.axis * (joint.axis @ (point - joint.point_m)))


def region(error: FloatArray, stated: float, least: FloatArray) -> tuple[float, float]:
    """Whether an error (k,) is inside, 1 or 0, and the stated deviation over that of the bound (k, k)."""
    trace = np.trace(least)
    square = error @ np.linalg.solve(least, error) * trace / stated**2
    return float(square < chi2.ppf(LEVEL, len(error))), float(stated / np.sqrt(trace))


def axis_told(
    axis: FloatArray | None, stated: float | None, truth: MadeJoint, least: Bound, j: int
) -> tuple[float, float]:
    if axis is None or not stated:
        return np.nan, np.nan
    off = axis / (axis @ truth.axis) - truth.axis  # on the plane that touches the sphere at the truth
    return region(normals(truth.axis) @ off, stated, least.axis(j))


def point_told(
    point: FloatArray | None, stated: float | None, truth: MadeJoint, least: Bound, j: int
) -> tuple[float, float]:
    if point is None or not stated:
        return np.nan, np.nan
    off = point - truth.point_m
    return region(off if truth.type == "spherical" else normals(truth.axis) @ off, stated, least.point(j))


def states_told(fit: Fit, joint: Joint, truth: FloatArray) -> float:
    """Share of states inside, once the arbitrary zero is taken out."""
    q, std = states_of(fit, joint)
    known = np.all(np.isfinite(q) & (std > 0), axis=-1)
    if q.shape != truth.shape or not known.any():
        return np.nan
    off, variance = without_zero(q[known], truth[known], std[known] ** 2)
    return float(np.mean(np.abs(off) < norm.ppf(0.5 + LEVEL / 2) * np.sqrt(variance)))


def without_zero(q: FloatArray, truth: FloatArray, variance: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Errors of states (T, s) and what is left of their variances.

    Rotation vectors, s = 3, are of exp(q) = exp(error) exp(truth) zero: the mean of exp(truth)^-1 exp(q) is the zero.
    """
    if q.shape[1] == 3:
        turned = Rotation.from_rotvec(truth)
        zero = (turned.inv() * Rotation.from_rotvec(q)).mean()
        near = (turned * zero).as_rotvec()
        return q - near, variance * (1 - 1 / len(q))
    weight = 1 / variance
    off = q - truth
    left = np.maximum(variance - 1 / np.sum(weight), np.finfo(float).tiny)
    return off - np.sum(weight * off) / np.sum(weight), left


def share(values: list[float]) -> str:
    """Percentage and its standard error; blank if nothing is stated."""
    some = np.array(values)[np.isfinite(values)]
    if not len(some):
        return f"{'-':>6} {'':6} "
    mean, error = np.mean(some), np.std(some) / np.sqrt(len(some))
    miss = " " if WANTED[0] <= mean <= WANTED[1] else "<"
    return f"{100 * mean:6.1f} ±{100 * error:4.1f} {miss}"


def size(values: list[float]) -> str:
    """Median ratio."""
    some = np.array(values)[np.isfinite(values)]
    return f"{np.median(some):5.2f}" if len(some) else f"{'-':>5}"


def row(name: str, found: list[list[Told]]) -> str:
    """One line of the table."""
    joints = [joint for trial in found for joint in trial]
    lost = sum(not trial for trial in found)
    axis, point = ([getattr(joint, what) for joint in joints] for what in ("axis", "point"))
    left = f"{name:24} {len(joints):6d} {lost:5d}"
    by_axis = f"{share([a[0] for a in axis])} {size([a[1] for a in axis])}"
    by_point = f"{share([p[0] for p in point])} {size([p[1] for p in point])}"
    return f"{left} | {by_axis} | {by_point} | {share([joint.states for joint in joints])}"


def main() -> None:
    """Print a row for each joint type with poses and with positions alone, and for trees."""
    options = parser(__doc__, trials=400, quick=40)
    options.add_argument("--only", default="", help="rows whose name has this in it")
    chosen = options.parse_args()
    trials = range(trials_of(chosen))
    print(f"{'':24} {'':6} {'not':>5} | {'axis: inside':>14} {'size':>5} | {'point: inside':>14} {'size':>5} | states")
    print(f"{'data':24} {'joints':>6} {'found':>5} | {'[%]':>14} {'':>5} | {'[%]':>14} {'':>5} | inside [%]")
    for positions_only in (False, True):
        for number, kind in enumerate(TRAVELS):
            name = f"{kind}, {'positions' if positions_only else 'poses'}"
            if chosen.only not in name:
                continue
            if kind not in JOINT_TYPES:
                print(f"{name:24} no such joint type yet")
                continue
            jobs = [(kind, positions_only, [chosen.seed, number, positions_only, trial]) for trial in trials]
            print(row(name, each(try_single, jobs, chosen.workers)), flush=True)
    for root_moves in (False, True):
        name = f"trees, {'moving' if root_moves else 'static'} root"
        if chosen.only in name:
            jobs = [(root_moves, [chosen.seed, 10 + root_moves, trial]) for trial in trials]
            print(row(name, each(try_tree, jobs, chosen.workers)), flush=True)


if __name__ == "__main__":
    main()
