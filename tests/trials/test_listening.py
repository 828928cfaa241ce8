"""Nothing of a running capture can be reached from another machine."""

from __future__ import annotations

import os
import socket
from ipaddress import ip_address
from pathlib import Path

import pytest

from station.recording.live import free_port
from tests.trials.bench import bench
from tests.trials.listening import listening
from tests.trials.programs import capture_arguments, program
from tests.trials.test_ends import ON_BOTH


def reachable(pid: int) -> list[str]:
    """Where a program can be reached from elsewhere."""
    places = [place for table in listening(pid).values() for place in table]
    return [place for place in places if not ip_address(place.rpartition(":")[0]).is_loopback]


@pytest.mark.parametrize(("address", "elsewhere"), [("127.0.0.1", False), ("0.0.0.0", True)])
def test_an_open_port_is_noticed(address: str, elsewhere: bool) -> None:
    """The oracle sees what it is asked about."""
    with socket.create_server((address, 0)) as server:
        place = f"{address}:{server.getsockname()[1]}"
        assert place in listening(os.getpid())["tcp"]
        assert (place in reachable(os.getpid())) == elsewhere


@pytest.mark.parametrize("live", [False, True])
def test_a_capture_listens_to_nobody_elsewhere(tmp_path: Path, live: bool) -> None:
    port = free_port()
    more = ("--headless", "--port", str(port)) if live else ()
    with program(tmp_path, *capture_arguments(tmp_path, *more)) as running:
        running.wait_for_frames(5)
        places = listening(running.process.pid)
    assert [place for table in places.values() for place in table] == [f"127.0.0.1:{port}"] * live


@ON_BOTH
def test_with_a_viewer_port_that_is_taken_nothing_moves_and_nothing_is_written(tmp_path: Path, rig: str) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken, bench(tmp_path, rig) as lab:
        port = str(taken.getsockname()[1])
        before = [lab.each(register) for register in ("torque_enable", "goal_position", "led")]
        arguments = capture_arguments(tmp_path, "--headless", "--port", port, rig=str(lab.rig))
        with program(tmp_path, *arguments) as running:
            code, said = running.end()
        assert code == 1 and port in said and "Traceback" not in said
        assert [lab.each(register) for register in ("torque_enable", "goal_position", "led")] == before
        assert not any(lab.each("torque_enable")) and not running.session.exists()
