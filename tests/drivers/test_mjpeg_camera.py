"""IP cameras: real connections to a server on this machine that does what cameras do, and what they shouldn't."""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest

from drivers.camera import Frame
from drivers.clock import MonotonicClock
from drivers.errors import CameraError, CameraLost, CameraStalled, NoCamera, WrongSize
from drivers.live_camera import LiveCamera
from drivers.mjpeg_camera import mjpeg_camera
from tests.drivers.ip_camera import HEAD, SIZE, IpCamera, Script, chunked, jpeg, part, sends


def soon(seconds: float = 20.0) -> int:
    return time.monotonic_ns() + round(seconds * 1e9)


@contextmanager
def watched(script: Script, **wanted: Any) -> Iterator[tuple[LiveCamera, IpCamera]]:
    with IpCamera(script) as server:
        camera = camera_at(server.address, **wanted)
        try:
            camera.start()
            yield camera, server
        finally:
            camera.close()


def camera_at(address: str, **wanted: Any) -> LiveCamera:
    given = {"size_px": None, "fps": None, "stall_s": 5.0, **wanted}
    return mjpeg_camera(address, clock=MonotonicClock(), **given)


def read_to_the_end(camera: LiveCamera) -> tuple[list[Frame], CameraError]:
    frames: list[Frame] = []
    with pytest.raises(CameraError) as error:
        while frame := camera.read(soon()):
            frames.append(frame)
    return frames, error.value


def levels(frames: list[Frame]) -> list[int]:
    return [round(frame.image.mean() / 10) for frame in frames]


PARTS = b"".join(part(jpeg(k)) for k in range(5))
CHUNKED_HEAD = HEAD.replace(b"\r\n\r\n", b"\r\nTransfer-Encoding: chunked\r\n\r\n")


@pytest.mark.parametrize(
    "pieces",
    [
        [HEAD, PARTS],
        [HEAD + PARTS[:100], PARTS[100:1000], PARTS[1000:]],
        [HEAD.replace(b"1.1", b"1.0"), PARTS],
        [HEAD.replace(b"boundary=", b'boundary="--').replace(b"frame\r", b'frame"\r'), PARTS],
        [HEAD, PARTS.replace(b"Content-Length", b"X-Nothing"), b"--frame\r\n"],
        [CHUNKED_HEAD, chunked([PARTS[:9], PARTS[9:]]), b"0\r\n\r\n"],
        [HEAD, b"Welcome!\r\n", part(b"beat", b"text/plain"), PARTS, b"\r\n--frame--\r\n"],
    ],
    ids=["plain", "split", "http 1.0", "quoted dashes", "no lengths", "chunked", "junk and heart beats"],
)  # fmt: skip
def test_pictures_come_whole_and_in_order(pieces: list[bytes]) -> None:
    before_ns = time.monotonic_ns()
    with watched(sends(*pieces)) as (camera, _):
        frames, error = read_to_the_end(camera)
        assert levels(frames) == [0, 1, 2, 3, 4]
        assert [frame.index for frame in frames] == [0, 1, 2, 3, 4]
        assert {frame.stamp for frame in frames} == {"arrival"}
        stamps = [before_ns, *(frame.t_ns for frame in frames), time.monotonic_ns()]
        assert stamps == sorted(stamps)
        assert (camera.size_px, camera.fps, camera.dropped, camera.stale) == (SIZE, None, 0, 0)
        assert isinstance(error, CameraLost) and "the connection is lost" in str(error)


def test_a_picture_is_stamped_when_it_begins_to_arrive() -> None:
    """The server waits in the middle of a picture: the stamp is from before, the frame from after."""
    begun, ended = [0], [0]

    def script(connection: socket.socket, leave: threading.Event) -> None:
        body = part(jpeg(1))
        connection.sendall(HEAD + body[:-500])
        time.sleep(0.2)  # time to arrive
        begun[0] = time.monotonic_ns()
        time.sleep(0.2)
        ended[0] = time.monotonic_ns()
        connection.sendall(body[-500:])

    with watched(script) as (camera, _):
        (frame,), _ = read_to_the_end(camera)
    assert frame.t_ns < begun[0] < ended[0]


def test_a_picture_that_comes_again_is_stale() -> None:
    pieces = [part(jpeg(k)) for k in (1, 1, 1, 2, 1)]
    with watched(sends(HEAD, *pieces)) as (camera, _):
        frames, _ = read_to_the_end(camera)
        assert levels(frames) == [1, 2, 1]
        assert [frame.index for frame in frames] == [0, 1, 2]
        assert camera.stale == 2


def test_damaged_pictures_are_dropped_and_counted() -> None:
    cut, noise = jpeg(1)[:-40], b"\xff\xd8 no picture \xff\xd9"
    with watched(sends(HEAD, part(noise), part(jpeg(2)), part(cut), part(jpeg(3)))) as (camera, _):
        frames, _ = read_to_the_end(camera)
        assert levels(frames) == [2, 3]
        assert [frame.index for frame in frames] == [1, 3]
        assert camera.dropped == 2


def test_pictures_nobody_reads_are_dropped_oldest_first() -> None:
    pictures = [part(jpeg(k)) for k in range(1, 25)]
    sent = threading.Event()

    def script(connection: socket.socket, leave: threading.Event) -> None:
        for picture in (HEAD, *pictures):
            connection.sendall(picture)
            time.sleep(0.002)
        sent.set()
        leave.wait(20)

    with watched(script) as (camera, _):
        assert sent.wait(20)
        time.sleep(0.3)
        frames: list[Frame] = []
        while frame := camera.read(soon(0.2)):
            frames.append(frame)
        assert levels(frames)[-1] == 24 and len(frames) < 24
        assert camera.dropped == 24 - len(frames)
        assert frames[-1].index == 23


@pytest.mark.parametrize("before", [b"", HEAD, HEAD + PARTS[:300]])
def test_a_camera_that_answers_and_sends_nothing_has_stalled(before: bytes, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("drivers.mjpeg_camera.FIRST_FRAME_S", 0.0)

    def script(connection: socket.socket, leave: threading.Event) -> None:
        connection.sendall(before)
        leave.wait(20)

    with IpCamera(script) as server:
        camera = camera_at(server.address, stall_s=0.2)
        with pytest.raises(CameraError, match=r"no answer within 0\.2 s|sends no picture|nothing came|doesn't answer"):
            camera.start()
        camera.close()


def test_a_camera_that_falls_silent_has_stalled() -> None:
    def script(connection: socket.socket, leave: threading.Event) -> None:
        connection.sendall(HEAD + PARTS)
        leave.wait(20)

    with watched(script, stall_s=0.3) as (camera, _):
        frames, error = read_to_the_end(camera)
        assert len(frames) == 5
        assert isinstance(error, CameraStalled)
        assert "no new frame for 0.3 s" in str(error) or "nothing came for 0.3 s" in str(error)


def test_a_camera_that_drips_has_stalled() -> None:
    def script(connection: socket.socket, leave: threading.Event) -> None:
        connection.sendall(HEAD + part(jpeg(1)))
        for byte in part(jpeg(2)):
            connection.sendall(bytes([byte]))
            if leave.wait(0.02):
                return

    with watched(script, stall_s=0.3) as (camera, _):
        frames, error = read_to_the_end(camera)
        assert len(frames) == 1 and isinstance(error, CameraStalled) and "no new frame for 0.3 s" in str(error)


def test_a_frozen_camera_has_stalled_and_the_error_says_frozen() -> None:
    def script(connection: socket.socket, leave: threading.Event) -> None:
        connection.sendall(HEAD)
        while not leave.wait(0.01):
            connection.sendall(part(jpeg(7)))

    with watched(script, stall_s=0.5) as (camera, _):
        frames, error = read_to_the_end(camera)
        assert len(frames) == 1
        assert isinstance(error, CameraStalled) and "the same picture came" in str(error) and "frozen" in str(error)


@pytest.mark.parametrize("linger", [True, False], ids=["reset", "closed"])
def test_a_camera_that_vanishes_is_lost(linger: bool) -> None:
    def script(connection: socket.socket, leave: threading.Event) -> None:
        connection.sendall(HEAD + PARTS + part(jpeg(9))[:400])
        leave.wait(0.2)
        if linger:
            connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, b"\1\0\0\0\0\0\0\0")
            connection.close()

    with watched(script) as (camera, _):
        frames, error = read_to_the_end(camera)
        assert len(frames) == 5 and isinstance(error, CameraLost)
        assert "then start again" in str(error)


def test_close_does_not_wait_for_a_silent_camera() -> None:
    def script(connection: socket.socket, leave: threading.Event) -> None:
        connection.sendall(HEAD + PARTS)
        leave.wait(60)

    with watched(script, stall_s=30.0) as (camera, _):
        assert camera.read(soon()) is not None
        camera.close()
        assert not [thread for thread in threading.enumerate() if thread.name.startswith("camera")]


def test_a_part_that_is_too_long_ends_the_stream() -> None:
    with watched(sends(HEAD, PARTS, b"--frame\r\n\r\n", bytes(200_000)), max_part_bytes=100_000) as (camera, _):
        frames, error = read_to_the_end(camera)
        assert len(frames) == 5 and "want at most 100000" in str(error)


def test_a_bad_chunk_ends_the_stream() -> None:
    with watched(sends(CHUNKED_HEAD, chunked([PARTS]), b"zz\r\nrubbish")) as (camera, _):
        frames, error = read_to_the_end(camera)
        assert len(frames) == 5 and isinstance(error, CameraLost)


@pytest.mark.parametrize(
    ("answer", "says"),
    [
        (b"", "can't be reached"),
        (b"rubbish\r\n" * 10, "can't be reached"),
        (b"HTTP/1.1 404 Not Found\r\n\r\n", "answers 404 Not Found"),
        (b"HTTP/1.1 401 No\r\nWWW-Authenticate: Digest realm=x\r\n\r\n", r"it takes: Digest\)"),
        (b"HTTP/1.1 200 OK\r\nContent-Type: text/html\r\n\r\n<html>", "gives text/html; want multipart"),
        (b"HTTP/1.1 200 OK\r\n\r\n", "gives no Content-Type"),
        (HEAD + b"nothing", "the connection is lost"),
    ],
)
def test_what_is_no_camera_is_told(answer: bytes, says: str) -> None:
    with IpCamera(sends(answer)) as server:
        camera = camera_at(server.address)
        with pytest.raises(CameraError, match=says):
            camera.start()
        camera.close()


def test_nobody_there_is_no_camera() -> None:
    with IpCamera(sends()) as server:
        address = server.address
    with pytest.raises(NoCamera, match="can't be reached: Connection refused"):
        camera_at(address).start()


@pytest.mark.parametrize("address", ["http://", "http://host:port/", "http:///video", "http://[bad/video"])
def test_what_is_no_address_is_told(address: str) -> None:
    with pytest.raises(NoCamera, match="this is no address"):
        camera_at(address).start()


def test_another_size_is_refused() -> None:
    with IpCamera(sends(HEAD, PARTS)) as server:
        camera = camera_at(server.address, size_px=(640, 480))
        with pytest.raises(WrongSize, match="gives 64x48 px; want 640x480"):
            camera.start()
        camera.close()


def test_a_size_that_changes_is_an_error() -> None:
    with watched(sends(HEAD, part(jpeg(1)), part(jpeg(2, (32, 24))))) as (camera, _):
        frames, error = read_to_the_end(camera)
        assert len(frames) == 1 and isinstance(error, WrongSize)


def test_the_password_goes_to_the_camera_and_nowhere_else() -> None:
    seen: list[str] = []
    with IpCamera(sends(HEAD, PARTS)) as server:
        camera = camera_at(f"http://us%40er:sec%3Aret@{server.host}/video?channel=1&pwd=hidden")
        camera.start()
        _, error = read_to_the_end(camera)
        seen += [str(error), str(camera.settings)]
        camera.close()
    request = server.requests[0]
    assert request.startswith(b"GET /video?channel=1&pwd=hidden HTTP/1.1\r\n")
    assert b"Authorization: Basic dXNAZXI6c2VjOnJldA==\r\n" in request  # us@er:sec:ret
    with pytest.raises(NoCamera) as refused:
        camera.start()
    seen.append(str(refused.value))
    for text in seen:
        assert f"http://{server.host}/video?channel=1" in text
        assert not [secret for secret in ("sec", "ret@", "us%40er", "hidden", "dXNA") if secret in text]


def test_a_camera_starts_again() -> None:
    with watched(sends(HEAD, PARTS)) as (camera, server):
        for _ in range(2):
            camera.start()
            assert levels(read_to_the_end(camera)[0]) == [0, 1, 2, 3, 4]
        assert len(server.requests) == 3


def test_encryption_with_what_does_not_speak_it_is_told() -> None:
    with IpCamera(sends(b"hello\r\n\r\n"), reads_request=False) as server:
        camera = camera_at(f"https://{server.host}/video")
        with pytest.raises(NoCamera, match=r"can't be reached: .*(SSL|EOF|reset)"):
            camera.start()
        camera.close()


def test_an_address_that_http_cannot_ask_for_is_told_without_its_password() -> None:
    with IpCamera(sends(HEAD, PARTS)) as server:
        camera = camera_at(f"http://me:mine@{server.host}/my video?pwd=hidden")
        with pytest.raises(NoCamera, match="can't be reached: URL can't contain") as error:
            camera.start()
        assert "mine" not in str(error.value) and "hidden" not in str(error.value)
        camera.close()
