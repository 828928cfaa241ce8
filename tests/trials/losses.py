"""What a kill cost: a session's recording held against the ledger of the program that was killed."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from station.recording import Recording
from station.session import read_status
from tests.trials.programs import Line
from tests.trials.told import WITHOUT_IMAGE

KINDS = ("reading", "command", "frame", "image", "event", "taken")


@dataclass(frozen=True)
class Loss:
    """What is missing from a recording.

    Attributes:
        age_s: by kind, the time from the stamp of the first thing that is missing to the kill; 0 if nothing is. Of
            "taken", frames that the camera had given and that nobody had handed to the recording, those count that
            are younger than the last one recorded: others were dropped, and are counted by the capture.
        count: by kind, how many are missing.
        kept: by kind, how many are there.
        wrong: what is there and was never handed over, or is out of order; empty if all is well.
    """

    age_s: dict[str, float]
    count: dict[str, int]
    kept: dict[str, int]
    wrong: tuple[str, ...]

    @property
    def worst_s(self) -> float:
        """The greatest of all kinds."""
        return max(self.age_s.values())

    @property
    def nothing(self) -> bool:
        """Whether all that was handed to the recording is there."""
        return not any(count for kind, count in self.count.items() if kind != "taken")


def losses(recording: Recording, lines: Sequence[Line], killed_ns: int) -> Loss:
    """Hold a recording of one piece against the ledger of its program, killed at a monotonic time in ns."""
    images = Counter(elapsed_ns + recording.start_ns for elapsed_ns, _ in recording.frame_jpegs())
    recorded = {
        "reading": Counter(recording.stamps_ns[:, 0].tolist()),
        "command": Counter((recording.commanded.t_s * 1e9).round().astype(int) + recording.start_ns),
        "frame": Counter(recording.frame_ns.tolist()),
        "image": images,
        "event": Counter(event.text.replace("\n", " ") for event in recording.events),
    }
    age_s, count, wrong = {}, {}, []
    for kind, there in recorded.items():
        told = [line for line in lines if line.word == ("frame" if kind == "image" else kind)]
        if kind == "image":
            told = [line for line in told if line.text != WITHOUT_IMAGE]
        keys = [line.text if kind == "event" else line.stamp_ns for line in told]
        missing = [line for line, key in zip(told, keys, strict=True) if not there[key]]
        age_s[kind] = max((killed_ns - line.stamp_ns for line in missing), default=0) * 1e-9
        count[kind] = len(missing)
        if strange := sum((there - Counter(keys)).values()):
            wrong.append(f"{strange} {kind}s that were never handed over")
    last_ns = int(recording.frame_ns[-1]) if recording.frames else 0
    waiting = [line for line in lines if line.word == "taken" and line.stamp_ns > last_ns > 0]
    age_s["taken"] = max((killed_ns - line.stamp_ns for line in waiting), default=0) * 1e-9
    count["taken"], recorded["taken"] = len(waiting), Counter()
    kept = {kind: sum(there.values()) for kind, there in recorded.items()}
    return Loss(age_s, count, kept, tuple(wrong))


def untrue(folder: Path, recording: Recording, *, complete: bool = False) -> str:
    """What session.json of a killed session says that isn't so after it has been opened; empty if nothing.

    `complete` says whether the recording may have been closed before the kill.
    """
    status = read_status(folder)
    if status.state != "interrupted" and not (complete and status.state == "complete" and not recording.notices):
        return f"session.json says '{status.state}'"
    have = {"frames": recording.frames, "readings": len(recording.measured.t_s)}
    said = {name: status.counts.get(name) for name in have}
    return "" if said == have else f"session.json counts {said}, the recording has {have}"
