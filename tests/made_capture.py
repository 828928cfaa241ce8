"""A made capture on a terminal, as a program of its own: it moves until it is asked otherwise, and parks when it stops.

    python -m tests.made_capture FOLDER motion|hand|slow-start

Writes each state it enters into FOLDER/states.txt.
"""

from __future__ import annotations

import sys
import time
from datetime import UTC, datetime
from pathlib import Path

from station.capture.control import Wish
from station.capture.snapshot import JointSnapshot, Snapshot
from station.capture.states import State
from station.cli.attending import Attendant, attended
from station.session import SessionStatus, write_status

TURN_S = 0.02
CHECKING_S = 0.3
PARKING_S = 0.6
TOTAL_S = 60.0


class MadeCapture:
    """Obeys the attendant's control as the service does, with no arm."""

    def __init__(self, folder: Path, attendant: Attendant) -> None:
        self._folder, self._attendant = folder, attendant
        self._start_s = time.monotonic()

    def enter(self, state: State, step: str = "") -> None:
        """Go into a state and say so."""
        with (self._folder / "states.txt").open("a", encoding="utf-8") as file:
            file.write(f"{state}\n")
        self._tell(state, step)

    def _tell(self, state: State, step: str) -> None:
        done_s = time.monotonic() - self._start_s
        joint = JointSnapshot("elbow", "rad", 0.1 * done_s, 0.5, 41.0, 12.0, 0.1, 0.3)
        self._attendant.watch(
            Snapshot(state, done_s, done_s, TOTAL_S, step, (joint,), 7, 29.9, {"camera": 0}, {"link1": 0.1}, 0, "")
        )

    def run(self) -> None:
        """Move until a stop is asked for."""
        self.enter(State.CHECKING)
        time.sleep(CHECKING_S)
        self.enter(State.MOVING, "step 1 of 3")
        control = self._attendant.control
        while (wish := control.wish) is not Wish.STOP:
            if wish is Wish.PAUSE:
                self.enter(State.PAUSED, "step 1 of 3")
                while (wish := control.wait_while_paused(TURN_S)) is Wish.PAUSE:
                    self._tell(State.PAUSED, "step 1 of 3")
                if wish is Wish.RUN:
                    self.enter(State.MOVING, "step 1 of 3 again")
                continue
            self._tell(State.MOVING, "step 1 of 3")
            time.sleep(TURN_S)
        self.enter(State.PARKING, "parking")
        deadline_s = time.monotonic() + PARKING_S
        while time.monotonic() < deadline_s:
            if control.wish is Wish.PAUSE:
                self.enter(State.PAUSED, "parking")
                while control.wait_while_paused(TURN_S) is Wish.PAUSE:
                    self._tell(State.PAUSED, "parking")
                self.enter(State.PARKING, "parking")
            time.sleep(TURN_S)
        self.enter(State.IDLE, "arm left: park-then-release")


def main() -> None:
    """Run one made capture; as by the command line, a KeyboardInterrupt is exit code 130."""
    folder, kind = Path(sys.argv[1]), sys.argv[2]
    try:
        attend(folder, kind)
    except KeyboardInterrupt:
        sys.exit(130)


def attend(folder: Path, kind: str) -> None:
    """One capture of a kind."""
    with attended(folder, by_hand=kind == "hand") as attendant:
        if kind == "slow-start":
            (folder / "begun").touch()
            time.sleep(60.0)
        now = datetime.now(UTC)
        write_status(folder, SessionStatus("interrupted", "made", now, now, counts={"frames": 7}))
        MadeCapture(folder, attendant).run()


if __name__ == "__main__":
    main()
