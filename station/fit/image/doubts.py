"""What of the corners the tree does not explain, and what they tell in two ways; and how to say so."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from station.fit.image.corner_data import CornerData
from station.fit.image.image_fit import ImageFit
from station.fit.image.misfits import ALIKE, FAR_OFF, LEFT_OUT, MISFIT
from station.fit.image.two_answers import APART, Others
from station.fit.image.views import COORDINATES
from station.fit.noise import INLIER_ABOVE
from station.fit.skeleton import Skeleton
from station.logs import FloatArray

BoolArray = NDArray[np.bool_]

# Share of clean sessions in which chance alone makes some sighting, or some frame, one that is not explained.
FALSE_ALARMS = 0.005


def unexplained(data: CornerData, chi2: FloatArray) -> BoolArray:
    """(T, M) sightings that are farther off than chance allows, by their squared residuals (T, M); where only several
    together are, all of their frame.
    """
    seen = data.seen
    alone = seen & (chi2 > chdtri(COORDINATES, FALSE_ALARMS / max(int(seen.sum()), 1)))
    rest = seen & ~alone
    together = np.sum(chi2 * rest, axis=-1)
    freedom = np.maximum(COORDINATES * rest.sum(axis=-1), 1)
    limit = np.asarray(chdtri(freedom, FALSE_ALARMS / len(chi2)), dtype=np.float64)
    return alone | (rest & (together > limit)[:, None])


def parts_elsewhere(skeleton: Skeleton, others: Others, frames: int) -> BoolArray:
    """(T, K) parts that some other answer has elsewhere."""
    found = np.zeros((frames, len(skeleton.body_of)), dtype=bool)
    apart = others.deviations > APART
    for j in range(len(skeleton.joints)):
        moved = np.any(apart[:, skeleton.state_columns(j)], axis=-1)
        found[others.frame] |= moved[:, None] & (skeleton.hanging[j] > 0)
    found[others.frame] |= np.any(apart[:, skeleton.joint_states :], axis=-1)[:, None]
    return found


def with_other_answers(
    skeleton: Skeleton, state_covariance: tuple[FloatArray, ...], others: Others
) -> tuple[FloatArray, ...]:
    """Covariances (T, s, s) of each joint's states with the chance in them that another answer is right."""
    found: list[FloatArray] = []
    for j, covariance in enumerate(state_covariance):
        apart = others.apart[:, skeleton.state_columns(j)]
        wider = covariance.copy()
        np.add.at(wider, others.frame, others.probability[:, None, None] * apart[:, :, None] * apart[:, None, :])
        found.append(wider)
    return tuple(found)


def remarks_on_corners(image: ImageFit) -> list[str]:
    """Plain sentences on markers that the tree does not explain, and on frames that may be otherwise."""
    return [*_misfits(image), *_left_out(image), *_two_answers(image)]


def _misfits(image: ImageFit) -> list[str]:
    alike = image.alike > ALIKE
    return [
        *_far_off(
            image,
            image.misfit & alike & (image.scale > FAR_OFF),
            "and alike from frame to frame: the tree may be wrong there, and states of its joints with it; or a part "
            "bends or slips, or corners err alike, by more than stated",
        ),
        *_far_off(
            image,
            image.misfit & ~alike & (image.scale > MISFIT),
            "in each frame otherwise: there is more noise than stated; or a joint is a wrong one, and its states with "
            "it, or a part bends or slips",
        ),
    ]


def _far_off(image: ImageFit, which: BoolArray, why: str) -> list[str]:
    markers = np.flatnonzero(which).tolist()
    if not markers:
        return []
    times = ", ".join(f"{image.scale[m]:.1f}" for m in markers)
    return [f"the corners of {_named(image, markers)} are {times} times as far off as they should be, {why}"]


def _named(image: ImageFit, markers: Sequence[int]) -> str:
    views = image.views
    names = ", ".join(f"{views.marker_id[m]} ({views.parts[views.part[m]]})" for m in markers)
    return f"{'markers' if len(markers) > 1 else 'marker'} {names}"


def _left_out(image: ImageFit) -> list[str]:
    out = image.doubtful & (image.inlier <= INLIER_ABOVE)
    if not out.any():
        return []
    views = image.views
    counts = {m: int(np.sum(out & (views.marker == m))) for m in range(len(views.marker_id))}
    told = [f"{n} of marker {views.marker_id[m]} ({views.parts[views.part[m]]})" for m, n in counts.items() if n]
    first_s, count = float(views.t_s[views.frame[out]].min()), int(out.sum())
    fit = "fits the tree nowhere and is" if count == 1 else "fit the tree nowhere and are"
    found = [f"{count} of {len(out)} sightings {fit} left out, from t = {first_s:.1f} s: {', '.join(told)}"]
    many = [m for m, n in counts.items() if image.misfit[m] and n > LEFT_OUT * np.sum(views.marker == m)]
    if many:
        found.append(
            f"so many are left out of {_named(image, many)} that the tree may be wrong there, and states of its joints "
            "with it"
        )
    return found


def _two_answers(image: ImageFit) -> list[str]:
    views, frames = image.views, np.flatnonzero(image.two_answers.any(axis=1))
    if not frames.size:
        return []
    counts = image.two_answers.sum(axis=0).tolist()
    told = [f"{n} of {part}" for part, n in zip(views.parts, counts, strict=True) if n]
    what = "1 frame" if len(frames) == 1 else f"{len(frames)} frames"
    return [
        f"{what} may have the other of two answers, which corners tell alike, from t = {views.t_s[frames[0]]:.1f} s: "
        f"{', '.join(told)}; the deviations there are that large"
    ]
