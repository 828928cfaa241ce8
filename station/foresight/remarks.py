"""What is doubtful about a planned motion, in words: joints hardly seen, oblique views, smear, and what would do."""

from __future__ import annotations

from collections import Counter

import numpy as np

from station.foresight.detector import GOOD_SMEAR_PX, HIDDEN, OUTSIDE, REASONS, SEEN, SMEARED, TURNED_AWAY
from station.foresight.forecast import Forecast
from station.foresight.joints import JointOutlook
from station.motion import JointLimits

# Of a joint's way: less than this seen is worth a warning.
LITTLE_SEEN = 0.8
# Of the frames that show a joint's angle: more than this at a tilt over 60 deg is.
MOSTLY = 0.5
# What can be done about each reason.
ADVICE = {
    OUTSIDE: "move the camera back, or the motion's targets nearer to its middle",
    TURNED_AWAY: "put another marker on the other side, or turn less far",
    HIDDEN: "move the marker, or the camera to where nothing is between",
    SMEARED: "go slower",
}
NEARER = "turn the marker towards the camera, come nearer, or print it larger"


def forecast_remarks(forecast: Forecast, joints: tuple[JointOutlook, ...]) -> tuple[str, ...]:
    """Warnings, one sentence each or two; none if all will be seen well."""
    units = {joint.name: joint for joint in forecast.plan.joints}
    found = [remark for joint in joints if joint.moves for remark in _of_joint(forecast, joint, units[joint.name])]
    smear = _smear(forecast)
    return (*found, *((smear,) if smear else ()))


def _of_joint(forecast: Forecast, joint: JointOutlook, limits: JointLimits) -> list[str]:
    if joint.parent is None:
        return [f"{joint.name}: the mechanism has no joint of that name: nothing is known of what it moves"]
    if joint.unmarked:
        where = " and ".join(joint.unmarked)
        return [f"{joint.name}: its angle will not be seen: no marker on {where} whose place is known"]
    found: list[str] = []
    if joint.travel_share < LITTLE_SEEN:
        found.append(_little_seen(forecast, joint, limits))
    if joint.oblique_share > MOSTLY:
        percent = round(100 * joint.oblique_share)
        found.append(
            f"{joint.name}: in {percent} % of the frames that show it, its better marker is over 60 deg off the line "
            "of sight: expect several times the error; turn a marker towards the camera"
        )
    return found


def _little_seen(forecast: Forecast, joint: JointOutlook, limits: JointLimits) -> str:
    whole = " to ".join(limits.text(value) for value in joint.whole)
    if joint.visible is None:
        text = f"{joint.name}: nothing of its motion ({whole}) will be seen"
    else:
        visible = " to ".join(limits.text(value) for value in joint.visible)
        text = f"{joint.name}: {100 * joint.travel_share:.0f} % of its motion ({whole}) will be seen, at {visible}"
    body, reason, words = _main_reason(forecast, joint)
    return f"{text}; else mostly the markers of {body} are {words}: {ADVICE.get(reason, NEARER)}"


def _main_reason(forecast: Forecast, joint: JointOutlook) -> tuple[str, int, str]:
    """The body that is more often unseen while the joint isn't seen, and the commonest reason of its markers then."""
    unseen = ~joint.seen & (forecast.travel[:, [limits.name for limits in forecast.plan.joints].index(joint.name)] > 0)
    bodies = [body for body in (joint.parent, joint.child) if body is not None]
    gone = {body: ~forecast.seen[:, forecast.scene.rows_of(body)].any(axis=1) & unseen for body in bodies}
    body = max(bodies, key=lambda name: int(gone[name].sum()))
    counts: Counter[tuple[int, str]] = Counter()
    for row in forecast.scene.rows_of(body).tolist():
        reasons = forecast.reason[gone[body], row]
        by = forecast.obstacle[gone[body], row]
        for reason in np.unique(reasons).tolist():
            if reason == HIDDEN:
                rows, numbers = np.unique(by[reasons == HIDDEN], return_counts=True)
                for obstacle, number in zip(rows.tolist(), numbers.tolist(), strict=True):
                    counts[HIDDEN, f"hidden by {forecast.obstacles[obstacle]}"] += number
            elif reason != SEEN:
                counts[reason, REASONS[reason]] += int(np.sum(reasons == reason))
    (reason, words), _ = counts.most_common(1)[0]
    return body, reason, words


def _smear(forecast: Forecast) -> str | None:
    """The frame that smears most of those over what is good, and how much slower would do."""
    sight, what = forecast.sight, forecast.reason
    cells = np.array([mount.cells for mount in forecast.scene.mounts])
    good_px = np.minimum(GOOD_SMEAR_PX, sight.size_px / cells)
    over = np.where((what == SEEN) | (what == SMEARED), sight.smear_px / good_px, 0.0)
    frame, row = np.unravel_index(int(np.argmax(over)), over.shape)
    worst = float(over[frame, row])
    if worst <= 1:
        return None
    exposure_ms = 1e3 * forecast.scene.exposure_s
    return (
        f"marker {forecast.scene.mounts[row].marker_id} ({forecast.scene.mounts[row].part}) smears over "
        f"{sight.smear_px[frame, row]:.1f} px at t = {forecast.t_s[frame]:.1f} s, in the {exposure_ms:.3g} ms of "
        f"exposure; {good_px[frame, row]:.1f} px would be good: {_slower(forecast, int(frame), 1 / worst)} or an "
        f"exposure of {exposure_ms / worst:.2g} ms"
    )


def _slower(forecast: Forecast, frame: int, share: float) -> str:
    """The speeds of the joints that move at a frame, times a share."""
    period_s = float(forecast.t_s[1] - forecast.t_s[0]) if len(forecast.t_s) > 1 else forecast.plan.duration_s
    moving = [
        f"{joint.name} at {joint.text(share * travel / period_s)}/s instead of {joint.text(travel / period_s)}/s"
        for joint, travel in zip(forecast.plan.joints, forecast.travel[frame].tolist(), strict=True)
        if travel > 0
    ]
    return " and ".join(moving)
