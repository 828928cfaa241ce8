"""Which of a motion's joints the camera can tell the angle of, and when: a marker seen on either side."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from station.foresight.detector import OBLIQUE_RAD
from station.foresight.forecast import Forecast
from station.logs import BoolArray, FloatArray


@dataclass(frozen=True, eq=False, slots=True)
class JointOutlook:
    """What will be seen of one joint's motion.

    Attributes:
        name: of the arm's joint.
        moves: whether the motion moves it.
        parent, child: bodies that it connects; None for a joint that the mechanism doesn't have.
        unmarked: those of the two that carry no marker with a known place.
        seen: (T,) frames that show a marker on both: its angle is seen.
        share: of all frames, how many show its angle.
        travel_share: of the way that it goes, how much is seen; 1 for a joint that doesn't move.
        whole, visible: least and greatest state of the motion, and of what is seen of it; None if nothing is.
        tilt_rad: (T,) of the better marker on either body, the worse of the two; NaN where the angle isn't seen.
        oblique_share: of the frames that show its angle, how many at a tilt over 60 deg.
    """

    name: str
    moves: bool
    parent: str | None
    child: str | None
    unmarked: tuple[str, ...]
    seen: BoolArray
    share: float
    travel_share: float
    whole: tuple[float, float]
    visible: tuple[float, float] | None
    tilt_rad: FloatArray
    oblique_share: float


def joint_outlooks(forecast: Forecast) -> tuple[JointOutlook, ...]:
    """Each joint of the plan, in its order."""
    return tuple(_outlook(forecast, j) for j in range(len(forecast.plan.joints)))


def _outlook(forecast: Forecast, j: int) -> JointOutlook:
    name = forecast.plan.joints[j].name
    between = {joint.name: (joint.parent, joint.child) for joint in forecast.scene.tree.joints}
    parent, child = between[name] if name in forecast.scene.links else (None, None)
    bodies = [body for body in (parent, child) if body is not None]
    tilts = np.stack([_best_tilt(forecast, body) for body in bodies] or [np.full(len(forecast.t_s), np.inf)])
    tilt = np.asarray(tilts.max(axis=0), dtype=np.float64)
    seen = np.isfinite(tilt)
    q, travel = forecast.q[:, j], forecast.travel[:, j]
    total = float(travel.sum())
    ends = [(segment.q_from[j], segment.q_to[j]) for segment in forecast.plan.segments]
    whole = np.concatenate([q, np.ravel(ends)])
    return JointOutlook(
        name=name,
        moves=total > 0,
        parent=parent,
        child=child,
        unmarked=tuple(body for body in bodies if not len(forecast.scene.rows_of(body))),
        seen=seen,
        share=float(seen.mean()),
        travel_share=float(travel[seen].sum()) / total if total > 0 else 1.0,
        whole=(float(whole.min()), float(whole.max())),
        visible=(float(q[seen].min()), float(q[seen].max())) if seen.any() else None,
        tilt_rad=np.where(seen, tilt, np.nan),
        oblique_share=np.count_nonzero(tilt[seen] > OBLIQUE_RAD) / max(np.count_nonzero(seen), 1),
    )


def _best_tilt(forecast: Forecast, body: str) -> FloatArray:
    """(T,) the least tilt of the body's markers that are seen; inf where none is."""
    rows = forecast.scene.rows_of(body)
    tilt = np.where(forecast.seen[:, rows], forecast.sight.tilt_rad[:, rows], np.inf)
    return np.min(tilt, axis=1, initial=np.inf)
