"""The forecast of a planned motion: every marker at every frame, seen or not, and why not."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from station.foresight.detector import HIDDEN, OUTSIDE, REASONS, SEEN, SMEARED, TURNED_AWAY, reasons_but_hidden
from station.foresight.expectation import expected_states
from station.foresight.hiding import NOBODY, hidden_by, obstacle_bodies
from station.foresight.scene import Scene
from station.foresight.sight import Sight, sight
from station.logs import BoolArray, FloatArray
from station.motion import Plan

# A longer motion is looked at less often: frames more than these cost time and show nothing new.
MOST_FRAMES = 10_000


@dataclass(frozen=True, eq=False, slots=True)
class Forecast:
    """What the camera will see of a plan.

    Attributes:
        plan: the motion of J joints.
        scene: M mounts.
        t_s: (T,) the middles of the frames' exposures, from the start of the motion.
        q: (T, J) where the joints will be, rad or m.
        travel: (T, J) how far each will go from half a frame before to half a frame after.
        sight: of the markers at these times.
        reason: (T, M) of `station.foresight.detector.REASONS`.
        obstacle: (T, M) row in `obstacles`, -1 where nothing hides the marker.
        obstacles: bodies of what may hide markers.
    """

    plan: Plan
    scene: Scene
    t_s: FloatArray
    q: FloatArray
    travel: FloatArray
    sight: Sight
    reason: NDArray[np.intp]
    obstacle: NDArray[np.intp]
    obstacles: tuple[str, ...]

    @property
    def seen(self) -> BoolArray:
        """(T, M)."""
        return self.reason == SEEN

    def why(self, frame: int, row: int) -> str:
        """Why a marker isn't seen at a frame, in words."""
        reason = int(self.reason[frame, row])
        return f"hidden by {self.obstacles[self.obstacle[frame, row]]}" if reason == HIDDEN else REASONS[reason]


def foresee(plan: Plan, scene: Scene, t_s: FloatArray) -> Forecast:
    """The forecast of a plan for frames exposed about times (T,) from the start of the motion, evenly spaced."""
    exposed_s = t_s + scene.exposure_s * np.array([-0.5, 0.0, 0.5])[:, None]
    q = expected_states(plan, exposed_s)
    states = {joint.name: q[..., j] for j, joint in enumerate(plan.joints)}
    what = sight(scene, states)
    cells = np.array([mount.cells for mount in scene.mounts], dtype=np.intp)
    reason = reasons_but_hidden(what, scene.camera.size_px, cells)
    poses = scene.T_camera_bodies({name: state[1] for name, state in states.items()})
    obstacle = hidden_by(scene, poses, what.T_camera_marker, (reason != OUTSIDE) & (reason != TURNED_AWAY))
    reason = np.where((obstacle != NOBODY) & ((reason == SEEN) | (reason == SMEARED)), HIDDEN, reason)
    half_s = 0.5 * (t_s[1] - t_s[0]) if len(t_s) > 1 else 0.5 * plan.duration_s
    ends = expected_states(plan, np.stack([t_s - half_s, t_s + half_s]))
    return Forecast(
        plan=plan,
        scene=scene,
        t_s=t_s,
        q=q[1],
        travel=np.abs(ends[1] - ends[0]),
        sight=what,
        reason=reason,
        obstacle=obstacle,
        obstacles=obstacle_bodies(scene),
    )


def frame_times_s(duration_s: float, fps: float) -> FloatArray:
    """(T,) middles of evenly spaced frames, `fps` a second or as many as are looked at; one at least."""
    count = int(np.clip(np.floor(duration_s * fps), 1, MOST_FRAMES))
    return np.asarray((np.arange(count) + 0.5) * (duration_s / count), dtype=np.float64)


def states_at(forecast: Forecast, frame: int) -> Mapping[str, FloatArray]:
    """The arm's joints by name at a frame, rad or m."""
    return {joint.name: forecast.q[frame, j] for j, joint in enumerate(forecast.plan.joints)}
