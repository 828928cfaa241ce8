"""The end of every capture: the arm is left, threads end, the recording is closed, and no signal breaks that off."""

from __future__ import annotations

import threading
from collections.abc import Callable

from station.capture.counts import CaptureCounts
from station.capture.crew import Crew
from station.capture.recorder import SessionWriter


def end(
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
    failures = [] if failure is None else [failure]
    if failure is not None:
        crew.journal.error(failure)

    def finish() -> None:
        with crew.clock.seat():
            _try(failures, leave)
        for step in (crew.frames.end, crew.frames.check, crew.recorder.end, crew.recorder.check):
            _try(failures, step)
        state = "complete" if complete and not failures else "interrupted"
        _try(failures, lambda: writer.close(state, crew.counts().as_dict()))

    failures += unbroken(finish, "ending the capture")
    if failures:
        raise failures[0]
    return crew.counts()


def _try(failures: list[BaseException], step: Callable[[], object]) -> None:
    try:
        step()
    except BaseException as error:  # the first is raised when all is done
        failures.append(error)


def unbroken(work: Callable[[], None], name: str) -> list[BaseException]:
    """Do something to its end in a thread of its own, where no signal's exception reaches it.

    Returns what it raised, and the KeyboardInterrupts and SystemExits that came meanwhile.
    """
    done, raised = threading.Event(), list[BaseException]()

    def run() -> None:
        _try(raised, work)
        done.set()

    thread = threading.Thread(target=run, name=name)
    thread.start()
    while not done.is_set():
        try:
            done.wait()  # a thread's join, interrupted by a signal, takes the thread for ended
        except BaseException as interrupt:
            raised.append(interrupt)
    thread.join()
    return raised
