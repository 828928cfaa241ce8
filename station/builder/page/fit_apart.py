"""A trial, simulated and fitted, in a program of its own: the page goes on meanwhile, and it can be ended at any time.

The fit keeps every core busy for seconds or minutes; in the page's own program nothing would move, and a thread can't
be stopped. The program takes no notice of a Ctrl-C, which is the station's.
"""

from __future__ import annotations

import pickle
import signal
import subprocess
import sys
from contextlib import suppress
from typing import IO

from station.builder.draft import Draft
from station.builder.trial import Trial, TrialSettings, run_trial
from station.errors import StationError


class FitApart:
    """A trial that is under way.

    Args:
        draft: that is simulated.
        settings: how.
    """

    def __init__(self, draft: Draft, settings: TrialSettings) -> None:
        command = [sys.executable, "-P", "-m", "station.builder.page.fit_apart"]
        pipe = subprocess.PIPE
        self._program = subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=pipe, start_new_session=True)
        self._order = pickle.dumps((draft, settings))
        self.stopped = False

    def wait(self) -> Trial:
        """The trial, once it is done; to be called once.

        Raises:
            StationError: what the trial raised, or that the program has ended without a word.
        """
        answer, said = self._program.communicate(self._order)
        if self._program.returncode or not answer:
            last = said.decode(errors="replace").strip().splitlines()[-1:]
            raise StationError(f"the fit ended before its time (exit {self._program.returncode}): {''.join(last)}")
        result = pickle.loads(answer)
        if isinstance(result, str):
            raise StationError(result)
        return result

    def stop(self) -> None:
        """End it; `wait` raises soon."""
        self.stopped = True
        with suppress(OSError):
            self._program.kill()


def run(order: IO[bytes], answer: IO[bytes]) -> None:
    """What the program does: the draft and the settings come, the trial goes, or the text of its error."""
    draft, settings = pickle.load(order)
    try:
        result: Trial | str = run_trial(draft, settings)
    except StationError as error:
        result = str(error)
    answer.write(pickle.dumps(result))
    answer.flush()


if __name__ == "__main__":
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    run(sys.stdin.buffer, sys.stdout.buffer)
