"""The pictures of a stage, drawn by a program of its own.

In real time the threads of a capture share one interpreter: what one of them computes in Python keeps the others
waiting, and a picture takes most of a frame's time. A real camera doesn't take the station's time, and neither does
this. The program draws the same pictures to the bit, ends when the pipe to it is closed, however that comes about, and
takes no notice of a Ctrl-C, which is the station's.
"""

from __future__ import annotations

import os
import pickle
import signal
import struct
import subprocess
import sys
from contextlib import suppress
from io import BufferedReader, BufferedWriter
from typing import IO, BinaryIO, cast

import numpy as np
from numpy.typing import NDArray

from drivers.errors import CameraError
from station.logs import FloatArray
from station.stage import Stage

# A picture that is asked for: its number and the shape of the joint states, whose float64 follow.
REQUEST = struct.Struct("<4q")
# What the program says once it can draw, and the size of each picture before its bytes.
READY = b"ready"
SIZE = struct.Struct("<2q")
# For how long the program has time to end by itself once nobody asks for pictures, s.
END_S = 5.0


class StageApart:
    """Draws the pictures of a stage in another program while it is entered.

    Args:
        stage: what is drawn; a copy of it goes to the program.
    """

    def __init__(self, stage: Stage) -> None:
        self._stage = stage
        self._program: subprocess.Popen[bytes] | None = None

    def __enter__(self) -> StageApart:
        """Start the program; returns when it can draw.

        Raises:
            CameraError: it ended at once.
        """
        command = [sys.executable, "-P", "-m", "station.stage_apart"]
        self._program = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, start_new_session=True)
        try:
            self._send(pickle.dumps(self._stage))
            self._read(len(READY))
        except BaseException:
            self.__exit__()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        """End the program."""
        program, self._program = self._program, None
        if program is None:
            return
        for pipe in (program.stdin, program.stdout):
            with suppress(OSError):  # it may have gone before it took what was written last
                cast(IO[bytes], pipe).close()
        try:
            program.wait(END_S)
        except subprocess.TimeoutExpired:
            program.kill()
            program.wait()

    @property
    def pid(self) -> int:
        """The program's id.

        Raises:
            CameraError: it isn't started.
        """
        return self._running().pid

    def render(self, q: FloatArray, index: int) -> NDArray[np.uint8]:
        """(H, W, 3) BGR picture number `index` for joint states q (S, K, J), as `Stage.render` draws it.

        Raises:
            CameraError: the program has gone, or isn't started.
        """
        self._send(REQUEST.pack(index, *q.shape) + np.ascontiguousarray(q, np.float64).tobytes())
        height, width = SIZE.unpack(self._read(SIZE.size))
        return np.frombuffer(self._read(3 * height * width), np.uint8).reshape(height, width, 3)

    def _send(self, request: bytes) -> None:
        try:
            self._pipes()[0].write(request)
            self._pipes()[0].flush()
        except OSError as error:
            raise self._gone() from error

    def _read(self, size: int) -> bytearray:
        """So many bytes of the program's; a bytearray, as a picture may be drawn on."""
        buffer = bytearray(size)
        if self._pipes()[1].readinto(buffer) != size:
            raise self._gone()
        return buffer

    def _pipes(self) -> tuple[BufferedWriter, BufferedReader]:
        program = self._running()
        return cast(BufferedWriter, program.stdin), cast(BufferedReader, program.stdout)

    def _running(self) -> subprocess.Popen[bytes]:
        if self._program is None:
            raise CameraError("rendered camera: the program that draws its pictures isn't started; call start() first")
        return self._program

    def _gone(self) -> CameraError:
        return CameraError("rendered camera: the program that draws its pictures has ended; what it said stands above")


def draw(requests: BinaryIO, pictures: BinaryIO) -> None:
    """What the program does: the stage comes first, then one request after another until there are no more."""
    stage: Stage = pickle.load(requests)
    pictures.write(READY)
    pictures.flush()
    while len(request := requests.read(REQUEST.size)) == REQUEST.size:
        index, *shape = REQUEST.unpack(request)
        states = np.frombuffer(requests.read(8 * int(np.prod(shape)))).reshape(shape)
        picture = stage.render(states, index)
        pictures.write(SIZE.pack(*picture.shape[:2]) + picture.tobytes())
        pictures.flush()


if __name__ == "__main__":
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        draw(sys.stdin.buffer, sys.stdout.buffer)
    except BrokenPipeError:  # the station is gone: nobody is left to draw for
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
