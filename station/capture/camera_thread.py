"""Reads a capture's camera in a thread of its own, and opens it again where the rig says that it is waited for."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import replace

from drivers.camera import Camera, Frame
from drivers.clock import Clock
from drivers.errors import CameraEnded, CameraError
from station.capture.counts import Tally
from station.capture.journal import Journal

NS_PER_S = 1_000_000_000
# How long one read waits for a frame: so often the thread looks whether it is to end.
LOOK_NS = 50_000_000
# A camera that went away is looked for this often.
REOPEN_EVERY_NS = 500_000_000


class CameraThread:
    """Takes frames as they come.

    Frames are numbered on where a camera was opened again, and what it lost before stays counted.

    Args:
        take: gets each frame, in the thread; must not block but for a virtual clock's sake.
        reconnect_s: how long a camera that went away is waited for; 0: not at all.
    """

    def __init__(
        self,
        camera: Camera,
        clock: Clock,
        take: Callable[[Frame], None],
        journal: Journal,
        tally: Tally,
        reconnect_s: float,
    ) -> None:
        self._camera, self._clock, self._take = camera, clock, take
        self._journal, self._tally = journal, tally
        self._reconnect_s = reconnect_s
        self._ending, self._away = threading.Event(), threading.Event()
        self._failure: BaseException | None = None
        self._thread = threading.Thread(target=self._run, name="frames", daemon=True)
        self._next_index = self._first_index = 0
        self._before = (0, 0)  # dropped and stale frames, until it was last opened

    @property
    def away(self) -> bool:
        """Whether the camera went away and is waited for."""
        return self._away.is_set()

    @property
    def lost(self) -> tuple[int, int]:
        """Frames that the camera dropped, and stale ones, so far."""
        return self._before[0] + self._camera.dropped, self._before[1] + self._camera.stale

    def start(self) -> None:
        """Begin to read; from a thread that has its turn."""
        self._seat = self._clock.seat()
        self._thread.start()

    def check(self) -> None:
        """Raise what the camera failed with, if it did."""
        if self._failure is not None:
            raise self._failure

    def ask_to_end(self) -> None:
        """Read no further frame."""
        self._ending.set()

    def end(self) -> None:
        """Wait until the thread has ended; not from a thread that has its turn."""
        self._ending.set()
        if self._thread.ident is not None:
            self._thread.join()

    def _run(self) -> None:
        with self._seat:
            try:
                while not self._ending.is_set():
                    self._read()
            except BaseException as error:  # a thread can't raise to anyone: kept for check()
                self._failure = error
            self._away.clear()

    def _read(self) -> None:
        try:
            frame = self._camera.read(self._clock.now_ns() + LOOK_NS)
        except CameraEnded:
            raise
        except CameraError as error:
            self._reopen(error)
            return
        if frame is not None and not self._ending.is_set():
            numbered = replace(frame, index=self._first_index + frame.index)
            self._next_index = numbered.index + 1
            self._take(numbered)

    def _reopen(self, gone: CameraError) -> None:
        """Wait for the camera as long as the rig says; raises `gone` if it doesn't come back."""
        if self._reconnect_s <= 0:
            raise gone
        self._away.set()
        self._journal.warn(f"{gone}\nwaiting {self._reconnect_s:g} s for it")
        since_ns, lost = self._clock.now_ns(), self.lost
        while not self._ending.is_set():
            self._clock.sleep_until_ns(self._clock.now_ns() + REOPEN_EVERY_NS)
            try:
                self._camera.start()
            except CameraError:
                if self._clock.now_ns() - since_ns > self._reconnect_s * NS_PER_S:
                    raise gone from None
                continue
            self._before, self._first_index = lost, self._next_index
            self._tally.add("reconnects")
            self._journal.info("the camera is back")
            self._away.clear()
            return
