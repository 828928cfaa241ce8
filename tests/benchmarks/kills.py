"""`kill -9` at random moments of a capture: what each session still holds, whether it opens, fits and tells the truth.

A program captures a motion of three steps on the emulated arm and the rendered camera in real time, and writes down
beside the recording what it hands to it, and when (tests/trials/told.py). It is killed at a moment drawn evenly from
the life of a session, from its folder's making to the program's end. What was stamped more than 1 s before the kill has
to be there. A session of fewer frames than a fit wants is counted apart, with what the fit says.

Run: python -m tests.benchmarks.kills [--trials N] [--quick] [--seed N]
"""

from __future__ import annotations

import tempfile
import time
import traceback
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from station.commands import fitting
from station.errors import StationError
from station.recording import Recording
from tests.benchmarks.arguments import parser, trials_of
from tests.trials.losses import KINDS, Loss, losses, untrue
from tests.trials.programs import Line, capture_arguments, program

WANTED_S = 1.0
# A fit wants two parts seen together in ten frames.
FEW = 12


@dataclass
class Kill:
    """One kill and what came of it."""

    at_s: float
    phase: str
    loss: Loss | None = None
    fit: str = ""
    failures: list[str] = field(default_factory=list)


def phase_of(lines: list[Line]) -> str:
    """What the capture was doing when it wrote its last line."""
    marks = {"motion '": "moving", "motion done": "parking"}
    phase = "starting"
    for line in lines:
        if line.word == "close":
            phase = "closing"
        elif line.word == "event":
            phase = next((name for mark, name in marks.items() if line.text.startswith(mark)), phase)
    return phase


def session_s() -> float:
    """How long a session lasts that nobody kills, from its folder's making to the program's end."""
    with tempfile.TemporaryDirectory() as name, program(Path(name), *capture_arguments(Path(name))) as running:
        running.wait_for(running.session.is_dir, "session")
        begun_s = time.monotonic()
        code, said = running.end()
        assert code == 0, said
        return time.monotonic() - begun_s


def kill(at_s: float) -> Kill:
    """A capture that is killed so long after its folder was made."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        with program(folder, *capture_arguments(folder)) as running:
            running.wait_for(running.session.is_dir, "session")
            time.sleep(at_s)
            killed_ns, ended = running.kill(), running.process.returncode == 0
        lines = running.lines()
        done = Kill(at_s, "ended" if ended else phase_of(lines))
        try:
            judge(done, running.session, lines, killed_ns)
        except Exception as error:  # whatever it is, it is a failure of the session
            traceback.print_exc()
            done.failures.append(f"{type(error).__name__}: {error}")
        return done


def judge(done: Kill, session: Path, lines: list[Line], killed_ns: int) -> None:
    """Open, hold against the ledger, and fit the session of a kill."""
    if not lines:  # nothing was ever handed over: there may be no recording yet
        try:
            Recording.load(session)
            done.fit = "opened; nothing was recorded yet"
        except StationError as error:
            done.fit = f"there is no recording yet: {type(error).__name__}"
        return
    recording = Recording.load(session)
    ended = done.phase == "ended"
    if not recording.notices and not ended and done.phase != "closing":
        done.failures.append("opened without a notice")
    done.loss = losses(recording, lines, killed_ns)
    done.failures += done.loss.wrong
    done.failures += [
        f"{kind}s of {age_s:.2f} s before the kill are missing"
        for kind, age_s in done.loss.age_s.items()
        # Frames that are taken outside of the motion aren't meant to be recorded.
        if age_s > (0 if ended else WANTED_S) and (kind != "taken" or done.phase == "moving")
    ]
    closed = ended or (done.phase == "closing" and done.loss.nothing)
    if wrong := untrue(session, recording, complete=closed):
        done.failures.append(wrong)
    try:
        tree = fitting.fit(session, force=True).fit.tree
        done.fit = f"{len(tree.joints)} joints"
    except StationError as error:
        done.fit = f"{'none' if not recording.frames else 'a few'} frames: too few for a fit, and it says so"
        if recording.frames > FEW:
            done.failures.append(f"doesn't fit its {recording.frames} frames: {error}")


def show(kills: list[Kill]) -> None:
    """Print the losses by kind, what the fits found, and every failure."""
    seen = [each.loss for each in kills if each.loss is not None]
    print(f"phases: {dict(Counter(each.phase for each in kills))}")
    print(f"{'lost':10} {'median [s]':>10} {'p95 [s]':>8} {'max [s]':>8} {'items, max':>11} {'kept, all':>10}")
    for kind in KINDS:
        moving = [each.loss for each in kills if each.loss is not None and each.phase == "moving"]
        ages = np.array([loss.age_s[kind] for loss in (moving if kind == "taken" else seen)] or [0.0])
        most, kept = max(loss.count[kind] for loss in seen), sum(loss.kept[kind] for loss in seen)
        row = f"{np.median(ages):10.2f} {np.percentile(ages, 95):8.2f} {ages.max():8.2f} {most:11} {kept:10}"
        print(f"{kind + 's':10} {row}")
    for what, count in Counter(each.fit for each in kills).most_common():
        print(f"{count:4} x {what}")
    failed = [each for each in kills if each.failures]
    print(f"{len(kills) - len(failed)} of {len(kills)} kills without a failure")
    for each in failed:
        print(f"  at {each.at_s:.2f} s, {each.phase}: {'; '.join(each.failures)}")


def main() -> None:
    options = parser(__doc__, trials=100, quick=10)
    chosen = options.parse_args()
    trials, life_s = trials_of(chosen), session_s()
    print(f"a session lasts {life_s:.1f} s; {trials} kills, seed {chosen.seed}", flush=True)
    moments = np.random.default_rng(chosen.seed).uniform(0, life_s, trials)
    kills = []
    for at_s in moments.tolist():
        kills.append(kill(at_s))
        print(f"\r{len(kills)} of {trials}", end="", flush=True)
    print()
    show(kills)


if __name__ == "__main__":
    main()
