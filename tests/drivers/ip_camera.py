"""An IP camera on this machine: a socket, and a script that plays its part."""

from __future__ import annotations

import socket
import threading
from collections.abc import Callable, Iterable
from contextlib import suppress
from types import TracebackType

import cv2
import numpy as np

SIZE = (64, 48)
HEAD = b"HTTP/1.1 200 OK\r\nContent-Type: multipart/x-mixed-replace; boundary=frame\r\n\r\n"
Script = Callable[[socket.socket, threading.Event], None]


def jpeg(k: int, size_px: tuple[int, int] = SIZE) -> bytes:
    """A picture that is flat grey 10 k."""
    return cv2.imencode(".jpg", np.full((size_px[1], size_px[0], 3), 10 * k % 256, np.uint8))[1].tobytes()


def part(body: bytes, kind: bytes = b"image/jpeg") -> bytes:
    return b"--frame\r\nContent-Type: %b\r\nContent-Length: %d\r\n\r\n%b\r\n" % (kind, len(body), body)


class IpCamera:
    """Answers each connection by `script`, then closes it.

    The script gets the connection and an event that is set once the test is over, for which it waits if it hangs.
    """

    def __init__(self, script: Script, *, reads_request: bool = True) -> None:
        self._script = script
        self._reads_request = reads_request
        self._listener = socket.create_server(("127.0.0.1", 0))
        self._thread = threading.Thread(target=self._serve, name="ip camera")
        self.host = f"127.0.0.1:{self._listener.getsockname()[1]}"
        self.address = f"http://{self.host}/video"
        self.requests: list[bytes] = []
        self.leave = threading.Event()

    def __enter__(self) -> IpCamera:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.leave.set()
        with suppress(OSError):
            self._listener.shutdown(socket.SHUT_RDWR)
        self._listener.close()
        self._thread.join()

    def _serve(self) -> None:
        while True:
            try:
                connection, _ = self._listener.accept()
            except OSError:
                return
            with connection, suppress(OSError):
                if self._reads_request:
                    self.requests.append(_request(connection))
                self._script(connection, self.leave)
                with suppress(OSError):
                    connection.shutdown(socket.SHUT_RDWR)


def _request(connection: socket.socket) -> bytes:
    data = b""
    while not data.endswith(b"\r\n\r\n") and (more := connection.recv(4096)):
        data += more
    return data


def sends(*pieces: bytes) -> Script:
    def script(connection: socket.socket, _: threading.Event) -> None:
        for piece in pieces:
            connection.sendall(piece)

    return script


def chunked(pieces: Iterable[bytes]) -> bytes:
    """HTTP's chunked transfer encoding (RFC 9112, 7.1)."""
    return b"".join(b"%x\r\n%b\r\n" % (len(piece), piece) for piece in pieces if piece)
