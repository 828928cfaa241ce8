"""What happened to the samples of a capture, counted."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class CaptureCounts:
    """What happened to the samples of a session."""

    frames: int
    dropped_frames: int
    stale_frames: int
    commands: int
    readings: int
    bus_errors: int

    def as_dict(self) -> dict[str, int]:
        """The counts by name, as in session.json."""
        return {name: getattr(self, name) for name in self.__dataclass_fields__}
