"""Fits of simulated views held against the truth and the Cramer-Rao bound, joint by joint."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.stats import chi2, norm

from station.fit.image.views import IntArray, Views
from station.fit.learner import learn
from station.fit.options import FitOptions
from station.fit.result import Fit
from station.kinematics.tree import Joint
from station.logs import BoolArray, FloatArray
from station.tree_scores import score_tree
from tests.benchmarks.made_joints import MadeJoint, normals
from tests.benchmarks.read_fits import states_of
from tests.fit.image.image_bounds import JointBound, image_bounds
from tests.fit.image.simulated_views import Watched

LEVEL = 0.95
# Corners, or a state, farther from the truth than this many deviations are no matter of noise: the fit is in another
# minimum there.
FAR_SIGMAS = 6.0


@dataclass(frozen=True, eq=False)
class HeldJoint:
    """One joint of a fit against the true one and its bound.

    Attributes:
        bound: of it, in the frames of the parts that name the fit's bodies.
        seen: (T,) frames in which its child was seen, and its parent if it isn't a root that stands still.
        errors: (T, s) of its states, without their mean; NaN where the fit has none.
        std: (T, s) that the fit states for them.
        axis_error: (2,) along `normals` of the true axis; axis_std what the fit states, root of the trace; empty and
            NaN for a type without one.
        point_error: (2,) likewise, or (3,) of a spherical joint's centre.
    """

    bound: JointBound
    seen: BoolArray
    errors: FloatArray
    std: FloatArray
    axis_error: FloatArray
    axis_std: float
    point_error: FloatArray
    point_std: float

    @property
    def found(self) -> BoolArray:
        """(T,) frames with a state, of those in which the bound says that there can be one."""
        return np.all(np.isfinite(self.errors) & np.isfinite(self.bound.states), axis=-1)

    @property
    def share_found(self) -> float:
        """Of the frames in which the joint was seen, those in which the fit has a state."""
        return float((self.found & self.seen).sum() / max(self.seen.sum(), 1))

    @property
    def state_rms(self) -> float:
        """Root mean square of the errors [m or rad], of a vector's length."""
        return float(np.sqrt(np.mean(np.sum(self.errors[self.found] ** 2, axis=-1))))

    @property
    def ratio(self) -> float:
        """Root mean square error over that of the bound in the same frames."""
        return self.state_rms / float(np.sqrt(np.mean(np.sum(self.bound.states[self.found], axis=-1))))

    @property
    def chance(self) -> float:
        """The same of the best linear estimate of the very noise: what the ratio would be without fault of the fit."""
        best = self.bound.state_errors[self.found]
        least = self.bound.states[self.found]
        return float(np.sqrt(np.mean(np.sum(best**2, axis=-1)) / np.mean(np.sum(least, axis=-1))))

    @property
    def states_inside(self) -> float:
        """Share of the states' 95 % intervals that hold the truth; of a vector's numbers, of all."""
        rows = self.found & np.all(self.std > 0, axis=-1)
        return float(np.mean(np.abs(self.errors[rows]) < norm.ppf(0.5 + LEVEL / 2) * self.std[rows]))

    @property
    def state_size(self) -> float:
        """Stated deviations over those of the bound, root mean squares."""
        rows = self.found & np.all(self.std > 0, axis=-1)
        return float(np.sqrt(np.mean(self.std[rows] ** 2) / np.mean(self.bound.states[rows])))

    @property
    def axis_inside(self) -> tuple[float, float]:
        """Whether the 95 % region holds the true axis, 1 or 0, and the stated deviation over the bound's."""
        return region(self.axis_error, self.axis_std, self.bound.axis)

    @property
    def point_inside(self) -> tuple[float, float]:
        """The same of the point."""
        return region(self.point_error, self.point_std, self.bound.point)

    @property
    def inside_by_chance(self) -> tuple[float, float]:
        """Whether the bound's own 95 % regions hold the best linear estimate's errors of axis and point, 1 or 0."""
        of_axis = region(self.bound.axis_error, float(np.sqrt(np.trace(self.bound.axis))), self.bound.axis)
        of_point = region(self.bound.point_error, float(np.sqrt(np.trace(self.bound.point))), self.bound.point)
        return of_axis[0], of_point[0]


def region(error: FloatArray, stated: float, least: FloatArray) -> tuple[float, float]:
    """Of the ellipse with the bound's shape and the stated size, as a fit states one number for all directions."""
    if not error.size or not stated > 0 or not np.isfinite(least).all():
        return np.nan, np.nan
    trace = np.trace(least)
    square = error @ np.linalg.solve(least, error) * trace / stated**2
    return float(square < chi2.ppf(LEVEL, len(error))), float(stated / np.sqrt(trace))


@dataclass(frozen=True, eq=False)
class HeldFit:
    """A fit against the truth.

    Attributes:
        mistakes: sentences on a wrong tree; the joints are then empty.
        joints: in the order of the true tree's.
        wrong: (T,) frames in which corners that are no outliers, or states, are far from the truth: the fit is in
            another minimum there.
        told: (T,) frames of which it says that something in them is doubtful, or leaves something out.
    """

    fit: Fit
    mistakes: tuple[str, ...]
    joints: tuple[HeldJoint, ...]
    wrong: BoolArray
    told: BoolArray


def fitted(watched: Watched, options: FitOptions | None = None, *, image: bool = True) -> Fit:
    """The station's fit of the corners, or of the poses alone, from the true root."""
    kinds = tuple(dict.fromkeys(("rigid", "prismatic", "revolute", *watched.seen.scene.kinds)))
    options = options or FitOptions(joint_types=kinds, root=watched.tree.root)
    return learn(watched.poses, options, watched.views if image else None)


def held(watched: Watched, fit: Fit, camera: dict[str, float] | None = None) -> HeldFit:
    """A fit held against the truth; `camera` as for `image_bounds`."""
    scores = score_tree(fit.tree, watched.tree, watched.truth)
    far, told = _corners(watched, fit)
    if not scores.types_correct:
        return HeldFit(fit, scores.mistakes or ("wrong types",), (), far, told)
    parts, bodies = watched.made.parts, range(len(watched.made.joints) + 1)
    names = [next(p for p in fit.tree.bodies if watched.made.body_of[parts.index(p)] == body) for body in bodies]
    bounds = image_bounds(watched, frame_parts=[parts.index(name) for name in names], camera=camera)
    seen = _seen_bodies(watched)
    joints: list[HeldJoint] = []
    for bound, q in zip(bounds.joints, watched.made.q, strict=True):
        ends = names[bound.true.parent], names[bound.true.child]
        found = next(j for j in fit.tree.joints if {j.parent, j.child} == set(ends))
        if found.parent != ends[0]:
            raise ValueError(f"joint {found.name} is told from its child; want {ends[0]} as its parent")
        turned = watched.made.T_body_part[parts.index(ends[0])][:3, :3]
        q = q @ turned if bound.true.type == "spherical" else q
        joints.append(_held_joint(fit, found, bound, seen[:, bound.true.parent] & seen[:, bound.true.child], q))
    for joint in joints:
        square = np.sum(joint.errors**2, axis=-1) / np.sum(joint.bound.states, axis=-1)
        far = far | (square > FAR_SIGMAS**2)  # NaN compares false
        told = told | (joint.seen & ~joint.found)
    return HeldFit(fit, (), tuple(joints), far, told)


def _seen_bodies(watched: Watched) -> BoolArray:
    """(T, B) frames in which a body was seen by a sighting that is no outlier, or is a root that stands still."""
    views, good = watched.views, ~watched.outlier
    part = views.part[views.marker[good]]
    found = np.zeros((len(views.t_s), len(watched.made.joints) + 1), dtype=bool)
    found[views.frame[good], np.array(watched.made.body_of)[part]] = True
    found[:, 0] |= watched.made.root == "static"
    return found


def _corners(watched: Watched, fit: Fit) -> tuple[BoolArray, BoolArray]:
    """Frames (T,) with corners that the fitted tree has far from their true places, and those with doubtful ones."""
    frames = np.arange(len(watched.views.t_s))
    if fit.image is None:
        return frames < 0, frames < 0
    views, rows = fit.image.views, rows_of(watched, fit.image.views)
    off = fit.image.residual_px - watched.error_px[rows]  # measured less noise less model
    true = watched.views.covariance_px2[rows] / watched.seeing.stated**2
    square = np.einsum("ni,nij,nj->n", off, np.linalg.inv(true), off)
    far = (square > FAR_SIGMAS**2 * off.shape[-1]) & ~watched.outlier[rows]
    doubtful = np.asarray(fit.image.in_doubt, dtype=bool)
    return np.isin(frames, views.frame[far]), np.isin(frames, views.frame[doubtful])


def rows_of(watched: Watched, views: Views) -> IntArray:
    """(N,) of each sighting of a fit's views: that in what was watched."""
    key, all_keys = (x.marker_id[x.marker] + 1000 * x.frame for x in (views, watched.views))
    order = np.argsort(all_keys)
    return order[np.searchsorted(all_keys, key, sorter=order)]


def _held_joint(fit: Fit, found: Joint, bound: JointBound, seen: BoolArray, truth: FloatArray) -> HeldJoint:
    true = bound.true
    axis, point, sign = np.zeros(0), np.zeros(0), 1.0
    if found.axis_parent is not None:
        sign = float(np.sign(found.axis_parent @ true.axis))
        axis = normals(true.axis) @ (found.axis_parent / (found.axis_parent @ true.axis))
    if found.point_parent_m is not None:
        off = found.point_parent_m - true.point_m
        point = off if true.type == "spherical" else normals(true.axis) @ off
    q, std = states_of(fit, found)
    errors = state_errors(true, sign * q, truth)
    axis_std, point_std = (x if x is not None else np.nan for x in (found.axis_std_rad, found.point_std_m))
    return HeldJoint(bound, seen, errors, std, axis, axis_std, point, point_std)


def state_errors(joint: MadeJoint, q: FloatArray, truth: FloatArray) -> FloatArray:
    """(T, s) errors without their mean; NaN for NaN."""
    known = np.all(np.isfinite(q), axis=-1)
    errors = np.full(truth.shape, np.nan)
    if not known.any():
        return errors
    if joint.type == "spherical":
        off = Rotation.from_rotvec(truth[known]).inv() * Rotation.from_rotvec(q[known])
        errors[known] = (off * off.mean().inv()).as_rotvec()
        return errors
    off = q[known] - truth[known]
    if joint.type == "revolute":
        off = np.angle(np.exp(1j * (off - off[0]))) + off[0]
    errors[known] = off - off.mean(axis=0)
    return errors
