"""The end of every capture: the arm is left, threads end, the recording is closed, and no signal breaks that off."""

from __future__ import annotations

import threading
from collections.abc import Callable

from station.capture.counts import CaptureCounts
from station.capture.crew import Crew
from station.capture.recorder import SessionWriter


class Unbroken:
    """Does something to its end in a thread of its own, where no signal's exception reaches it.

    The thread waits from the start on: beginning one can be broken off, too.
    """

    def __init__(self, name: str) -> None:
        self._begins, self._done = threading.Event(), threading.Event()
        self._work: Callable[[], None] | None = None
        self._raised: list[BaseException] = []
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()

    def do(self, work: Callable[[], None]) -> list[BaseException]:
        """Do it; returns what it raised, and the KeyboardInterrupts and SystemExits that came meanwhile."""
        interrupts: list[BaseException] = []
        while not self._done.is_set():
            try:
                self._work = work
                self._begins.set()
                self._done.wait()  # a thread's join, interrupted by a signal, takes the thread for ended
            except BaseException as interrupt:
                interrupts.append(interrupt)
        self._thread.join()
        return [*self._raised, *interrupts]

    def _run(self) -> None:
        self._begins.wait()
        if self._work is not None:
            _try(self._raised, self._work)
        self._done.set()


def end(
    ending: Unbroken,
    crew: Crew,
    writer: SessionWriter,
    failure: BaseException | None,
    *,
    complete: bool,
    leave: Callable[[], None],
) -> CaptureCounts:
    """End a capture, whatever ended it.

    The arm comes first: frames that wait to be detected, and a disk that is slow, can wait until it is left.

    Args:
        failure: what the capture failed with, raised again when all is done; else the first failure in here is.
        complete: whether all that was to be recorded has been.
        leave: brings the arm into the state that the rig declares; called in a turn.
    """
    failures: list[BaseException] = []

    def finish() -> None:
        if failure is not None:
            failures.append(failure)
            crew.journal.error(failure)
        with crew.clock.seat():
            _try(failures, leave)
        frames, recorder = crew.frames, crew.recorder
        frames, recorder = crew.frames, crew.recorder
        for step in (frames.end, frames.check, crew.end_states, crew.tell_shed, recorder.end, recorder.check):
            _try(failures, step)
        state = "complete" if complete and not failures else "interrupted"
        _try(failures, lambda: writer.close(state, crew.counts().as_dict()))

    raised = ending.do(finish)
    for error in (*failures, *raised):
        raise error
    return crew.counts()


def _try(failures: list[BaseException], step: Callable[[], object]) -> None:
    try:
        step()
    except BaseException as error:  # the first is raised when all is done
        failures.append(error)
