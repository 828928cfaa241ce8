"""Nothing of a running capture can be reached from another machine."""

from __future__ import annotations

import os
import socket
from ipaddress import ip_address
from pathlib import Path

import pytest

from tests.trials.listening import listening
from tests.trials.programs import capture_arguments, program


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


def test_a_capture_listens_to_nobody_elsewhere(tmp_path: Path) -> None:
    with program(tmp_path, *capture_arguments(tmp_path)) as running:
        running.wait_for_frames(5)
        assert reachable(running.process.pid) == []
