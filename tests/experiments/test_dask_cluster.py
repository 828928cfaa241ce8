"""Sweeps on a real Dask cluster of this machine: the same rows as in one process, whatever dies meanwhile."""

import os
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest

from station.errors import InvalidData
from station.experiments import DaskCluster, read_sweep, run_sweep
from station.kinematics.tree_json import to_json
from tests.experiments.cluster import ROOT, Cluster, running_cluster
from tests.experiments.made_sweeps import DOOR, LEVELS, Here, numbers, small_grid

pytest.importorskip("distributed", reason="the extra 'cluster' is not installed")

REPEATS = 10
GRID = small_grid(noise=LEVELS, inflation=(0,), repeats=REPEATS)
# Far more than any of it takes on a busy machine.
WAIT_S = 170.0
pytestmark = pytest.mark.timeout(400)


def sweeping(folder: Path, address: str) -> "subprocess.Popen[str]":
    """The command as a program of its own: a Dask client leaves threads behind."""
    (folder / "door.json").write_text(to_json(DOOR.tree))
    levels = [",".join(str(value) for value in values) for values in zip(*map(vars_of, LEVELS), strict=True)]
    grid = ("--methods", "station", "--frames", "20", "--inflation", "0", "--repeats", str(REPEATS))
    noise = ("--noise-translation-m", levels[0], "--noise-rotation-rad", levels[1])
    where = ("--out", str(folder / "out"), "--trees", str(folder / "door.json"), "--executor", address)
    command = (sys.executable, "-c", "from station.cli import main; main()", "sweep", *where, *grid, *noise)
    return subprocess.Popen(command, cwd=ROOT, text=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE)


def vars_of(level: object) -> tuple[float, ...]:
    return tuple(vars(level).values())


def wait_for_rows(folder: Path, count: int, program: "subprocess.Popen[str]") -> None:
    rows, end_s = folder / "out" / "rows.jsonl", time.monotonic() + WAIT_S
    while program.poll() is None and not (rows.exists() and rows.read_bytes().count(b"\n") >= count):
        assert time.monotonic() < end_s
        time.sleep(0.05)


def local_rows(folder: Path) -> list[tuple[object, ...]]:
    return [numbers(row) for row in run_sweep(GRID, folder / "local", Here()).rows]


def test_a_worker_killed_in_mid_sweep_loses_and_doubles_nothing_and_changes_no_number(tmp_path: Path):
    with running_cluster() as cluster, sweeping(tmp_path, cluster.address) as program:
        wait_for_rows(tmp_path, 1, program)
        os.kill(cluster.workers[0], signal.SIGKILL)
        _, said = program.communicate(timeout=WAIT_S)
        assert program.returncode == 0, said
    assert len((tmp_path / "out" / "rows.jsonl").read_text().splitlines()) == len(GRID)
    assert [numbers(row) for row in read_sweep(tmp_path / "out").rows] == local_rows(tmp_path)


def test_a_scheduler_that_goes_away_is_an_error_what_is_done_stays_and_another_goes_on(tmp_path: Path):
    def broken_off(cluster: Cluster) -> str:
        with sweeping(tmp_path, cluster.address) as program:
            wait_for_rows(tmp_path, 1, program)
            os.kill(cluster.pid, signal.SIGKILL)
            _, said = program.communicate(timeout=WAIT_S)
            assert program.returncode == 1
        return said

    with running_cluster() as cluster:
        said = broken_off(cluster)
    before = [numbers(row) for row in read_sweep(tmp_path / "out").rows]
    assert f"no Dask scheduler answers at {cluster.address}" in said and "Traceback" not in said
    assert f"{len(before)} of {len(GRID)} fits are kept" in said and len(said.splitlines()) <= 5
    assert 0 < len(before) < len(GRID)
    after = [numbers(row) for row in run_sweep(GRID, tmp_path / "out", Here()).rows]
    assert set(before) < set(after) and len(after) == len(GRID)


def test_an_unreachable_scheduler_is_an_error_within_seconds(tmp_path: Path):
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))  # and doesn't listen
        with sweeping(tmp_path, f"tcp://127.0.0.1:{free.getsockname()[1]}") as program:
            out, said = program.communicate(timeout=WAIT_S)
    assert (program.returncode, out) == (1, "") and "no Dask scheduler answers at tcp://127.0.0.1" in said
    assert len([line for line in said.splitlines() if line]) <= 5 and "Traceback" not in said


@pytest.mark.parametrize("address", ["", "127.0.0.1:8786", "http://127.0.0.1:8786", "tcp://127.0.0.1", "tcp://:8786"])
def test_what_is_no_address_is_refused(address: str):
    with pytest.raises(InvalidData, match="is no address; want processes, or such as"):
        DaskCluster(address)
