"""Trees learned anew where the corners don't bear out what was learned, and markers have two poses each.

What hides a tree, or makes another one of it, are poses on the wrong branch in a good part of the frames. So it is
learned again from logs in which these are chosen otherwise (pose_choices), and from the poses that are nearest to the
likeliest of these trees, until one leaves no doubt. The likeliest by the corners is kept.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from station.errors import InvalidData
from station.fit.asking import Asking
from station.fit.image.corner_data import CONSTANT, costs_of_squares
from station.fit.image.image_fit import ImageFit
from station.fit.image.pose_choices import two_poses
from station.fit.image.simpler import explains_as_well
from station.fit.image.two_answers import UNDECIDED
from station.fit.image.views import COORDINATES, Views
from station.fit.noise import INLIER_ABOVE
from station.fit.result import Fit
from station.kinematics.joints import JOINT_TYPES
from station.logs import PoseLog

# Doubtful is a tree that leaves out more of a marker's sightings, or has its corners so many deviations of chance
# farther off than those of the better markers, below this quantile.
LEFT_OUT, CHANCE_SIGMAS, BETTER = 0.1, 4.0, 0.25
# Numbers of a sighting that its frame's states leave, about.
LEFT_OVER = 5.0
# Of the poses of some part so many are to be otherwise at least, for a tree to be.
OTHERWISE = 0.1
# In -2 log likelihood: less is no likelier tree.
CLEARER = 1.0
# Numbers of a pose.
OF_A_POSE = 6


@dataclass(frozen=True, eq=False)
class _Look:
    """A fit, the numbers that it has, and its -2 log likelihood by the corners and twice these (Akaike, 1974)."""

    fit: Fit
    numbers: float
    cost: float

    @staticmethod
    def of(fit: Fit, log: PoseLog, views: Views) -> _Look:
        """At a fit of the parts of a log from some views."""
        numbers, square = numbers_of(fit, log, views), square_of(fit, log, views)
        return _Look(fit, numbers, square + 2 * numbers)

    def is_likelier(self, than: _Look) -> bool:
        """Whether it is to be preferred: not for motion that errors which repeat would make, too."""
        needless = self.numbers > than.numbers and explains_as_well(than.fit.image, self.fit.image)
        return self.cost < than.cost - CLEARER and not needless


def looked_again(fit: Fit, log: PoseLog, views: Views, learned: Callable[[PoseLog], Asking[Fit]]) -> Asking[Fit]:
    """The likeliest tree, if the one that was learned is doubtful; else that.

    Args:
        fit: as learned from the log.
        log: that is from the views.
        views: of all of its parts.
        learned: learns from another log of these parts.
    """
    if not is_doubtful(fit):
        return fit
    poses = two_poses(log, views)
    if poses.share < OTHERWISE:
        return fit
    best = _Look.of(fit, log, views)
    looks = [best]
    others = [poses.likelier, poses.between, poses.wider]
    others += [] if fit.image is None else [partial(poses.as_told, fit.image, _in_doubt(fit.image))]
    for other in others:
        looks += yield from _look(other(), log, views, learned)
        while (likeliest := _likeliest(looks)) is not best and likeliest.fit.image is not None:
            best = likeliest
            if not is_doubtful(best.fit):
                return _told(looks)
            looks += yield from _look(poses.as_told(likeliest.fit.image), log, views, learned)
    return _told(looks)


def _look(other: PoseLog, log: PoseLog, views: Views, learned: Callable[[PoseLog], Asking[Fit]]) -> Asking[list[_Look]]:
    try:
        fit = yield from learned(other)
    except InvalidData:  # from these poses nothing can be learned
        return []
    return [_Look.of(fit, log, views)]


def _likeliest(looks: Sequence[_Look]) -> _Look:
    best = looks[0]
    for look in looks[1:]:
        best = look if look.is_likelier(best) else best
    return best


def is_doubtful(fit: Fit) -> bool:
    """Whether corners are left out or far off for some marker, or nothing connects the bodies."""
    return fit.image is None or len(fit.tree.trees) > 1 or bool(_in_doubt(fit.image))


def _in_doubt(image: ImageFit) -> frozenset[str]:
    """Parts of which corners are left out or far off."""
    marker, count = image.views.marker, len(image.views.marker_id)
    seen = np.maximum(np.bincount(marker, minlength=count), 1)
    left_out = np.bincount(marker, image.inlier <= INLIER_ABOVE, minlength=count) / seen
    usual = float(np.quantile(image.scale, BETTER))
    too_far = image.scale / usual > 1 + CHANCE_SIGMAS / np.sqrt(2 * LEFT_OVER * seen)
    parts: list[int] = image.views.part[(left_out > LEFT_OUT) | too_far].tolist()
    return frozenset(image.views.parts[k] for k in parts)


def square_of(fit: Fit, log: PoseLog, views: Views) -> float:
    """-2 log likelihood of all corners by a fit, but for a constant.

    Those of a body that nothing connects are as far off as chance has them, whose poses are told frame by frame.
    """
    image, found, scale = fit.image, 0.0, 1.0
    if image is not None:
        sightings, scale = np.bincount(image.views.marker, minlength=len(image.scale)), float(np.median(image.scale))
        found = float(np.sum(costs_of_squares(image.chi2)) + 2 * COORDINATES * np.sum(sightings * np.log(image.scale)))
    sightings, poses = _unconnected(fit, log, views)
    return found + sightings * (COORDINATES + CONSTANT + 2 * COORDINATES * float(np.log(scale))) - OF_A_POSE * poses


def numbers_of(fit: Fit, log: PoseLog, views: Views) -> float:
    """That were fitted: states, poses of roots that move and of bodies that nothing connects, what all frames share."""
    _, poses = _unconnected(fit, log, views)
    poses += 0 if fit.image is None else sum(_root_poses(bodies, fit.image) for bodies in fit.tree.trees)
    of_states = float(np.isfinite(fit.states.q).sum())
    of_joints = sum(JOINT_TYPES[joint.type].parameters for joint in fit.tree.joints)
    return of_states + of_joints + OF_A_POSE * (len(fit.tree.mounts) + poses)


def _root_poses(bodies: Sequence[str], image: ImageFit) -> int:
    """Poses that a tree's root has: one if it stands still."""
    column = next((image.views.parts.index(body) for body in bodies if body in image.views.parts), None)
    if column is None:
        return 0
    T = image.T_ref_part[:, column]
    known = T[np.isfinite(T).all(axis=(-2, -1))]
    return len(known) if len(known) and np.ptp(known, axis=0).max() > 0 else 1


def _unconnected(fit: Fit, log: PoseLog, views: Views) -> tuple[int, int]:
    """Sightings of parts that no tree connects, and in how many frames these were seen, all together."""
    connected = () if fit.image is None else fit.image.views.parts
    alone = [k for k, part in enumerate(views.parts) if part in log.parts and part not in connected]
    rows = np.isin(views.part[views.marker], alone)
    poses = len(np.unique(views.frame[rows] * len(views.parts) + views.part[views.marker[rows]]))
    return int(rows.sum()), poses


def _told(looks: Sequence[_Look]) -> Fit:
    """The likeliest; if another tree is nearly as likely, with a warning."""
    best = _likeliest(looks)
    others = [look for look in looks if _edges(look.fit) != _edges(best.fit)]
    near = min(others, key=lambda look: look.cost, default=None)
    if near is None or near.cost > best.cost + UNDECIDED:
        return best.fit
    told = [
        f"{kind} {' to '.join(sorted(ends))}" for kind, ends in sorted(_edges(near.fit) - _edges(best.fit), key=str)
    ]
    odds = float(np.exp((near.cost - best.cost) / 2))
    warning = (
        f"another tree explains the corners nearly as well ({', '.join(told) or 'with fewer joints'}): the odds are "
        f"{odds:.1f} to 1; bring the markers nearer, or tilt them"
    )
    return replace(best.fit, tree=replace(best.fit.tree, warnings=(*best.fit.tree.warnings, warning)))


def _edges(fit: Fit) -> set[tuple[str, frozenset[str]]]:
    found = {(joint.type, frozenset((joint.parent, joint.child))) for joint in fit.tree.joints}
    return found | {("rigid", frozenset(group)) for group in fit.tree.rigid_groups}
