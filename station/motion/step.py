"""What a step of a motion is: a kind has a key in motion.toml, and makes legs of any arm's limits."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar, Protocol

from station.logs import FloatArray
from station.motion.limits import JointLimits
from station.motion.segment import Mode, Segment


class Step(Protocol):
    """A kind of step.

    Attributes:
        kind: its key in motion.toml.
        remedy: what to change where it goes too far or too fast.
    """

    kind: ClassVar[str]
    remedy: ClassVar[str]

    def legs(self, q: FloatArray, joints: Sequence[JointLimits], mode: Mode) -> list[Segment]:
        """Its legs from pose q (J,), numbers and times left at 0.

        Raises:
            InvalidData: what it can't be made of, such as joints that aren't there.
            LimitExceeded: it asks for more than a joint's greatest speed.
        """
        ...

    def text(self, joints: Sequence[JointLimits]) -> str:
        """What it does, in a few words."""
        ...
