"""`station build` without a browser: what it says and refuses, how it ends, that it serves this machine alone."""

from __future__ import annotations

import asyncio
import json
import os
import signal
import socket
import subprocess
import sys
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from station.builder import edits
from station.builder.draft import blank
from station.builder.stored import aside, keep_aside, load_draft, save_draft
from station.commands import building
from station.errors import StationError
from station.formats.rig import parse_rig

viser = pytest.importorskip("viser", reason="the extra 'gui' is not installed")

ROOT = Path(__file__).parent.parent


@contextmanager
def running(folder: Path, *arguments: str) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """The command in a program of its own, and the first line that it printed."""
    command = [sys.executable, "-c", "from station.cli import main; main()", "build", "--no-browser", *arguments]
    pipe = subprocess.PIPE
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    with subprocess.Popen(command, cwd=folder, env=environment, stdout=pipe, stderr=pipe, text=True) as program:
        try:
            assert program.stdout is not None
            yield program, program.stdout.readline().strip()
        finally:
            program.kill()


def test_it_says_where_it_is_and_ctrl_c_ends_it_with_130(tmp_path: Path):
    with running(tmp_path, "lamp", "--json") as (program, line):
        said = json.loads(line)
        assert said["address"].startswith("http://127.0.0.1:") and said["file"] == str(tmp_path / "lamp.json")
        with urllib.request.urlopen(said["address"]) as page:
            assert b"viser" in page.read().lower()
        program.send_signal(signal.SIGINT)
        out, err = program.communicate(timeout=60)
    assert program.returncode == 130 and out == ""
    assert "unsaved" not in err and "Traceback" not in err
    assert list(tmp_path.iterdir()) == []


def test_changes_that_were_not_saved_are_taken_up_again_and_sigterm_keeps_them(tmp_path: Path):
    file = tmp_path / "chair.json"
    save_draft(blank(), file)
    keep_aside(edits.add_part(load_draft(file), "seat"), file)
    with running(tmp_path, "chair.json") as (program, _):
        program.terminate()
        _, err = program.communicate(timeout=60)
    assert program.returncode == 143
    assert "took up unsaved changes of chair.json" in err
    assert f"unsaved changes of chair.json are kept in {aside(file)}" in err
    assert aside(file).exists() and load_draft(file).parts == ("base",)


def test_a_taken_port_is_a_clear_error(station, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(tmp_path)
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        code, out, err = station("build", "--no-browser", "--port", port)
    assert (code, out) == (1, "")
    assert f"can't serve the builder on 127.0.0.1:{port}: Address already in use" in err and "--port" in err


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (["nonsense"], "packaged ones are"),
        (["--host", "192.0.2.1"], "must be an address of this machine"),
    ],
)
def test_what_cannot_be_opened_or_served_is_a_clear_error(station, tmp_path, monkeypatch, arguments, complaint):
    monkeypatch.chdir(tmp_path)
    code, out, err = station("build", "--no-browser", *arguments)
    assert (code, out) == (1, "") and complaint in err and len(err.splitlines()) <= 5


def test_without_viser_it_says_what_to_install(station, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setitem(sys.modules, "viser", None)
    code, out, err = station("build", "--no-browser")
    assert (code, out) == (1, "") and "pip install 'capture-fit-station[gui]'" in err


@pytest.mark.parametrize("origin", ["http://elsewhere.example", "null", "own"])
def test_pages_of_others_in_the_same_browser_are_refused(tmp_path, monkeypatch, origin: str):
    monkeypatch.chdir(tmp_path)
    with building.build() as builder:
        asked = asyncio.run(connected(builder.address, builder.address if origin == "own" else origin))
    assert asked == (origin == "own")


async def connected(address: str, origin: str) -> bool:
    """Whether a websocket is opened for a page of that origin."""
    from websockets.asyncio.client import connect
    from websockets.exceptions import InvalidStatus
    from websockets.typing import Origin, Subprotocol

    try:
        protocol = Subprotocol(f"viser-v{viser.__version__}")
        async with connect(address.replace("http", "ws"), origin=Origin(origin), subprotocols=[protocol]):
            return True
    except InvalidStatus as error:
        assert error.response.status_code == 403
        return False


def test_two_builders_have_a_port_each_and_one_ends_without_the_other(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with building.build() as first:
        with building.build("swivel_chair") as second:
            assert first.address != second.address
        with urllib.request.urlopen(first.address) as page:
            assert page.status == 200
        with pytest.raises(OSError):
            urllib.request.urlopen(second.address, timeout=5)


def test_a_draft_of_another_programs_is_not_overwritten_unasked(tmp_path, monkeypatch):
    """Saving into the kinematics.json of a fit would lose its scores: the page asks first."""
    from station.builder.page.builder import opened

    monkeypatch.chdir(tmp_path)
    save_draft(blank(), tmp_path / "drawn.json")
    (tmp_path / "fitted.json").write_text(
        (tmp_path / "drawn.json").read_text("utf-8").replace('"drawn"', '"station"'), "utf-8"
    )
    assert opened("drawn.json")[1:] == (tmp_path / "drawn.json", True)
    assert opened("fitted.json")[1:] == (tmp_path / "fitted.json", False)
    with pytest.raises(StationError, match="packaged ones are"):
        opened("nothing")


def test_a_rig_is_written_of_a_tree_and_no_page_is_opened(station, tmp_path):
    out = tmp_path / "chair.toml"
    code, said, err = station("build", "lamp", "--rig", out, "--json")
    assert code == 0 and json.loads(said)["rig"] == str(out)
    assert f"station run {out} explore" in err
    assert parse_rig(out.read_text("utf-8"), "chair.toml").simulation is not None
    again, _, complaint = station("build", "lamp", "--rig", out, "--by-hand")
    assert again == 1 and "is there already" in complaint
    assert station("build", "--rig", out)[0] == 2
