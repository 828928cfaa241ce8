"""IP cameras that send Motion JPEG over HTTP, read without OpenCV, which makes their time stamps up."""

from __future__ import annotations

import base64
import http.client
import socket
import ssl
import threading
from collections.abc import Mapping
from contextlib import closing, suppress
from urllib.parse import SplitResult, unquote, urlsplit

import numpy as np

from drivers.addresses import without_secrets
from drivers.camera import STALL_S, FrameQueue, Setting
from drivers.clock import Clock
from drivers.errors import CameraError, CameraLost, CameraStalled, NoCamera
from drivers.live_camera import FIRST_FRAME_S, LiveCamera, Taken
from drivers.multipart import MAX_PART_BYTES, BadStream, Part, PartSplitter, read_boundary
from drivers.stored_frames import decode_image

READ_BYTES = 1 << 16
NS = 1_000_000_000
# Seconds that `take` waits before it says that there is nothing, and `release` for the thread.
WAIT_S = 0.1
RELEASE_S = 1.0
# Parts of these kinds, and those that don't say, are pictures; others (heart beats, alarms) are passed over.
PICTURES = ("image/jpeg", "image/jpg", "")


def mjpeg_camera(
    address: str,
    *,
    size_px: tuple[int, int] | None,
    fps: float | None,
    clock: Clock,
    stall_s: float = STALL_S,
    max_part_bytes: int = MAX_PART_BYTES,
) -> LiveCamera:
    """An IP camera by its http:// or https:// address, which may hold a user name and password.

    A picture's stamp is the time when its first bytes arrive. A connection that ends is an error: nothing reconnects
    by itself, as what was missed meanwhile would be missing without a sign.

    Args:
        size_px: (width, height) that the pictures must have; None for whatever comes.
        fps: frames a second, nominal: nothing in the stream tells.
        stall_s: for connecting, and without a new picture, before it is an error.
        max_part_bytes: a longer part is an error.
    """
    name = f"camera '{without_secrets(address)}'"

    def opened() -> MjpegStream:
        return MjpegStream(address, name, fps=fps, clock=clock, stall_s=stall_s, max_part_bytes=max_part_bytes)

    return LiveCamera(name, opened, size_px=size_px, clock=clock, stall_s=stall_s)


class MjpegStream:
    """A connection, and a thread of its own that receives, so that nothing keeps it from stamping what arrives.

    Raises:
        NoCamera: nothing answers, the answer is an error or no multipart stream.
        CameraStalled: no picture comes in time; CameraLost where the connection ends before one.
    """

    def __init__(
        self, address: str, name: str, *, fps: float | None, clock: Clock, stall_s: float, max_part_bytes: int
    ) -> None:
        self._address = address
        self._name = name
        self._clock = clock
        self._stall_s = stall_s
        self._max_part_bytes = max_part_bytes
        self._parts: FrameQueue[Part] = FrameQueue()
        self._told_dropped = 0
        self._last_body = b""
        self._socket: socket.socket | None = None
        self._answered = False
        self._thread = threading.Thread(target=self._run, name="camera stream", daemon=True)
        self._thread.start()
        try:
            first, self.size_px = self._take_first()
        except BaseException:
            self.release()
            raise
        self._first: Taken | None = first
        self.fps = fps
        self.settings: Mapping[str, Setting] = {
            "source": without_secrets(address),
            "backend": "HTTP",
            "size_px": f"{self.size_px[0]}x{self.size_px[1]}",
            "fps": fps,
            "pixel_format": "JPEG",
        }

    def take(self) -> Taken | None:
        first, self._first = self._first, None
        if first is not None:
            return first
        part = self._parts.get(WAIT_S)
        return None if part is None else self._taken(part)

    def release(self) -> None:
        self._parts.close()
        if self._socket is not None:
            # Wakes the thread, wherever in reading it is; closing alone would not. The plain socket's own method, as
            # one with encryption would first say good-bye to a peer that may be dead.
            with suppress(OSError):
                socket.socket.shutdown(self._socket, socket.SHUT_RDWR)
        self._thread.join(RELEASE_S)

    def _run(self) -> None:
        """The thread: connects and receives; whatever ends it is told to who takes the pictures."""
        try:
            connection = _connection(self._address, self._name, self._stall_s)
        except NoCamera as error:
            self._parts.fail(error)
            return
        try:
            with closing(self._ask(connection)) as response:
                splitter = PartSplitter(self._boundary(response), max_part_bytes=self._max_part_bytes)
                self._answered = True
                self._receive(response, splitter)
        except Exception as error:  # whatever it is, it is the reader's
            self._parts.fail(error)
        finally:
            connection.close()

    def _ask(self, connection: http.client.HTTPConnection) -> http.client.HTTPResponse:
        split = urlsplit(self._address)
        path = (split.path or "/") + (f"?{split.query}" if split.query else "")
        try:
            connection.connect()
            self._socket = connection.sock  # the response takes it over
            connection.request("GET", path, headers=_headers(split))
            return connection.getresponse()
        except (OSError, ValueError, http.client.HTTPException) as error:
            why = f"no answer within {self._stall_s:g} s" if isinstance(error, TimeoutError) else _reason(error)
            raise NoCamera(
                f"{self._name}: it can't be reached: {why}\ncheck the address, and that the camera is on"
            ) from None

    def _boundary(self, response: http.client.HTTPResponse) -> bytes:
        if response.status == http.client.UNAUTHORIZED:
            wants = response.headers.get("WWW-Authenticate", "").partition(" ")[0] or "none"
            raise NoCamera(
                f"{self._name}: it refuses the user name and password, or there is none (it takes: {wants})\n"
                "write them into the address, http://USER:PASSWORD@host/...; Basic is the kind that is spoken here"
            )
        if response.status != http.client.OK:
            raise NoCamera(f"{self._name}: it answers {response.status} {response.reason}\ncheck the address's path")
        try:
            return read_boundary(response.headers.get("Content-Type", ""))
        except BadStream as error:
            raise NoCamera(f"{self._name}: {error}\nlook up the camera's address for MJPEG or 'video stream'") from None

    def _receive(self, response: http.client.HTTPResponse, splitter: PartSplitter) -> None:
        """Stamp what arrives and take it apart; pictures aren't decoded here. Raises what ended the stream."""
        try:
            while not self._parts.closed and not splitter.ended and (data := response.read1(READ_BYTES)):
                for part in splitter.feed(data, self._clock.now_ns()):
                    if part.body and part.headers.get("content-type", "").partition(";")[0].lower() in PICTURES:
                        self._parts.put(part)
        except BadStream as error:
            raise CameraError(f"{self._name}: {error}\nit may be no camera, or a damaged one") from None
        except TimeoutError:
            raise CameraStalled(f"{self._name}: nothing came for {self._stall_s:g} s\ncheck the network") from None
        except (OSError, ValueError, http.client.HTTPException) as error:
            raise self._lost(_reason(error)) from None
        raise self._lost("the camera ended the stream")

    def _lost(self, why: str) -> CameraLost:
        return CameraLost(f"{self._name}: the connection is lost: {why}\ncheck camera and network, then start again")

    def _take_first(self) -> tuple[Taken, tuple[int, int]]:
        """The first picture that can be decoded, and its size; those before it count as lost."""
        until_ns = self._clock.now_ns() + round(max(self._stall_s, FIRST_FRAME_S) * NS)
        lost = 0
        while (part := self._parts.get_until(until_ns, self._clock)) is not None:
            taken = self._taken(part)
            lost += taken.lost
            if taken.image is not None:
                size_px = (taken.image.shape[1], taken.image.shape[0])
                return Taken(taken.t_ns, taken.stamp, taken.image, lost=lost), size_px
            lost += 1
        what = "answers, and sends no picture" if self._answered else "doesn't answer"
        raise CameraStalled(f"{self._name}: it {what} within {max(self._stall_s, FIRST_FRAME_S):g} s")

    def _taken(self, part: Part) -> Taken:
        dropped = self._parts.dropped
        lost, self._told_dropped = dropped - self._told_dropped, dropped
        if part.body == self._last_body:
            return Taken(part.t_ns, "arrival", None, stale=True, lost=lost)
        self._last_body = part.body
        return Taken(part.t_ns, "arrival", decode_image(np.frombuffer(part.body, dtype=np.uint8)), lost=lost)


def _connection(address: str, name: str, timeout_s: float) -> http.client.HTTPConnection:
    try:
        split = urlsplit(address)
        host, port = split.hostname, split.port
    except ValueError:  # a port that is no number, brackets that don't close
        split, host, port = None, None, None
    if split is None or not host:
        raise NoCamera(f"{name}: this is no address; want http://host:port/path")
    if split.scheme == "https":
        # Cameras' certificates are signed by nobody; a password is safer so than in the open.
        context = ssl.create_default_context()
        context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
        return http.client.HTTPSConnection(host, port, timeout=timeout_s, context=context)
    return http.client.HTTPConnection(host, port, timeout=timeout_s)


def _headers(split: SplitResult) -> dict[str, str]:
    headers = {"Accept": "multipart/x-mixed-replace, image/jpeg", "Connection": "close", "User-Agent": "station"}
    if split.username is not None:
        pair = f"{unquote(split.username)}:{unquote(split.password or '')}"
        headers["Authorization"] = f"Basic {base64.b64encode(pair.encode()).decode()}"
    return headers


def _reason(error: Exception) -> str:
    """What went wrong, without anything of the address in it."""
    if isinstance(error, OSError) and error.strerror:
        return error.strerror
    return without_secrets(str(error)) or type(error).__name__
