"""A motion laid out in time for given joints: what will be commanded when."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from station.errors import InvalidData
from station.logs import FloatArray, frozen_floats
from station.motion.easing import RAMP_S, eased_share
from station.motion.limits import JointLimits
from station.motion.segment import Mode, Segment
from station.motion.step import Step

DEFAULT_RATE_HZ = 50.0


@dataclass(frozen=True, slots=True)
class Motion:
    """A scripted motion.

    Attributes:
        mode: "step" sends each target at once and lets the servo limit its speed, as in the paper (IV-D);
            "stream" sends targets interpolated at `rate_hz`.
        notes: what was done to it before, in words, such as that a recording was slowed.
    """

    name: str
    steps: tuple[Step, ...]
    mode: Mode = "step"
    rate_hz: float = DEFAULT_RATE_HZ
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False, slots=True)
class Plan:
    """A motion laid out in time for given joints: what will be commanded when.

    Attributes:
        joints: J limits, in the order of all arrays.
        segments: its legs, in time order, without gaps, from t = 0; the start of each is a checkpoint.
    """

    motion: Motion
    joints: tuple[JointLimits, ...]
    segments: tuple[Segment, ...]

    @property
    def duration_s(self) -> float:
        """Time from the first command to the end of the last rest."""
        return self.segments[-1].t_end_s

    @property
    def park(self) -> FloatArray:
        """(J,) pose in which the arm parks, and a whole motion starts."""
        return frozen_floats([joint.park for joint in self.joints])

    @property
    def start(self) -> FloatArray:
        """(J,) pose in which this plan starts: its first leg's."""
        return self.segments[0].q_from

    @property
    def checkpoints_s(self) -> FloatArray:
        """(N,) when each leg starts."""
        return frozen_floats([segment.t_start_s for segment in self.segments])

    def restarted(self, leg: int) -> Plan:
        """The plan for going on at rest where a leg starts: one in the middle of a curve gets under way smoothly, which
        takes a little longer. Legs keep their numbers, earlier ones and the start of this one their times.

        Raises:
            InvalidData: there is no such leg.
        """
        if not 0 <= leg < len(self.segments):
            raise InvalidData(f"motion '{self.motion.name}' has no leg {leg}; its {len(self.segments)} count from 0")
        before, again, after = self.segments[:leg], self.segments[leg], self.segments[leg + 1 :]
        if again.curve is None or again.curve_from_s == 0 or again.under_way_s > 0:
            return self
        ramp_s = min(RAMP_S, again.move_s)
        again = replace(again, under_way_s=ramp_s, move_s=again.move_s + ramp_s / 2)
        return replace(self, segments=(*before, *timed([again, *after], again.t_start_s)))

    def command_times_s(self) -> FloatArray:
        """(N,) times of commands: at each segment; at rate_hz while a streamed one moves, and at its end."""
        if self.motion.mode == "step":
            return self.checkpoints_s
        return frozen_floats(np.unique(np.concatenate([self._ticks(segment) for segment in self.segments])))

    def _ticks(self, segment: Segment) -> FloatArray:
        count = int(np.ceil(segment.move_s * self.motion.rate_hz)) + 1
        ticks = segment.t_start_s + np.arange(count) / self.motion.rate_hz
        return np.minimum(ticks, segment.t_start_s + segment.move_s)

    def commanded(self, t_s: ArrayLike) -> FloatArray:
        """Commanded states (..., J), rad or m, at times (...,) from the start; before it, where it starts."""
        t = np.asarray(t_s, dtype=np.float64)
        index = self.segment_index(t)
        q_from, q_to = (np.stack([getattr(s, name) for s in self.segments])[index] for name in ("q_from", "q_to"))
        states = q_from + self._share(t, index)[..., None] * (q_to - q_from)
        for k in set(index.ravel().tolist()):  # curves have formulas of their own; legs are few beside times
            segment = self.segments[k]
            if segment.curve is not None:
                states[index == k] = segment.states(t[index == k])
        return np.where((t < self.segments[0].t_start_s)[..., None], self.start, states)

    def segment_index(self, t_s: ArrayLike) -> NDArray[np.intp]:
        """Index (...,) of the segment that is under way at times (...,) from the start; 0 before it."""
        return np.maximum(np.searchsorted(self.checkpoints_s, np.asarray(t_s), side="right") - 1, 0)

    def _share(self, t: FloatArray, index: NDArray[np.intp]) -> FloatArray:
        if self.motion.mode == "step":
            return np.ones_like(t)
        start_s, move_s, ramp_s = (
            np.array([getattr(segment, name) for segment in self.segments])[index]
            for name in ("t_start_s", "move_s", "ramp_s")
        )
        return eased_share(t - start_s, move_s, ramp_s)


def timed(segments: list[Segment], t_s: float = 0.0) -> Iterator[Segment]:
    """The segments, one after the other from t_s on."""
    for segment in segments:
        yield replace(segment, t_start_s=t_s)
        t_s += segment.move_s + segment.hold_s
