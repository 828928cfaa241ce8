"""`station sweep`: what is typed, what is refused, and signals and kills in mid-sweep, as programs of their own."""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Generator
from contextlib import contextmanager, suppress
from pathlib import Path

import pytest

from station.experiments import read_sweep, run_cell
from station.experiments import sweep as sweep_module
from station.kinematics.tree_json import to_json
from tests.experiments.made_sweeps import DOOR, Here, made_up_cells, numbers

Station = Callable[..., tuple[int, str, str]]
ROOT = Path(__file__).parent.parent.parent
COMMAND = (sys.executable, "-c", "from station.cli import main; main()", "sweep")
# Far more than any of it takes on a busy machine.
WAIT_S = 150.0


@pytest.fixture
def door(tmp_path: Path) -> Path:
    """A tree's file."""
    path = tmp_path / "door.json"
    path.write_text(to_json(DOOR.tree))
    return path


@pytest.fixture
def made_up(monkeypatch: pytest.MonkeyPatch) -> None:
    """Rows are made up, in this thread, and nothing is drawn: what the command says of them is to be seen."""
    monkeypatch.setattr("station.report.figure5.write_figure5", lambda sweep, folder: ())
    monkeypatch.setattr(sweep_module, "run_cells", made_up_cells)
    monkeypatch.setattr(sweep_module, "Processes", lambda: Here())
    monkeypatch.setattr("station.commands.sweeping.Processes", lambda count: Here())


@pytest.mark.usefixtures("made_up")
def test_a_sweep_without_options_is_experiment_1_by_both_methods(station: Station, tmp_path: Path):
    code, out, err = station("sweep", "--out", tmp_path / "new", "--json")
    told = json.loads(out)
    assert (code, told["fits"], told["failed"], len(told["levels"])) == (0, 128, 0, 32), err
    assert {level["tree"] for level in told["levels"]} == {"experiment1"}
    assert {(level["fits"], level["structure_correct"]) for level in told["levels"]} == {(4, 4)}
    assert len(read_sweep(tmp_path / "new").rows) == 128
    assert f"{tmp_path / 'new' / 'sweep.parquet'}" in told["files"]


@pytest.mark.usefixtures("made_up")
def test_any_grid_is_told_by_flags(station: Station, tmp_path: Path, door: Path):
    noise = (
        "--noise-translation-m",
        "0.001,0.01,0.02",
        "--noise-rotation-rad",
        "0.05",
        "--noise",
        "student",
        "--freedom",
        5,
    )
    motion = ("--motion", "smooth", "--root", "static", "--frames", 50, "--outliers", 0.1, "--missing", 0.2)
    counts = ("--inflation", "0,5", "--repeats", 2, "--seed", 7, "--methods", "paper", "--known-noise")
    trees = ("--trees", door, "--trees", "swivel_chair")
    code, out, err = station("sweep", "--out", tmp_path / "out", *noise, *motion, *counts, *trees)
    assert code == 0, err
    grid = read_sweep(tmp_path / "out").grid
    assert [named.name for named in grid.trees] == ["door", "swivel_chair"] and grid.methods == ("paper",)
    assert [(level.translation_m, level.rotation_rad) for level in grid.noise] == [
        (0.001, 0.05),
        (0.01, 0.05),
        (0.02, 0.05),
    ]
    assert (grid.inflation, grid.repeats, grid.seed) == ((0, 5), 2, 7)
    noise_of = grid.noise_of(grid.noise[1])
    assert (noise_of.name, grid.noise_parameters) == ("student", {"freedom": 5})
    options = grid.options
    assert (options.motion, options.root, options.frames, options.known_noise) == ("smooth", "static", 50, True)
    assert (options.outliers, options.missing) == (0.1, 0.2)
    assert "swivel_chair" in out and "24 fits" in out


@pytest.mark.usefixtures("made_up")
def test_quick_is_a_few_fits_of_all_noise_levels(station: Station, tmp_path: Path):
    assert station("sweep", "--out", tmp_path / "out", "--quick")[0] == 0
    sweep = read_sweep(tmp_path / "out")
    assert sweep.complete and len(sweep.grid) == 16 and len(sweep.grid.noise) == 4


@pytest.mark.usefixtures("made_up")
def test_the_same_command_again_goes_on_and_more_repeats_extend(station: Station, tmp_path: Path, door: Path):
    told = ("sweep", "--out", tmp_path / "out", "--trees", door, "--methods", "station", "--json")
    assert json.loads(station(*told, "--repeats", 1)[1])["fits"] == 16
    lines = (tmp_path / "out" / "rows.jsonl").read_text()
    assert json.loads(station(*told, "--repeats", 2)[1])["fits"] == 32
    assert (tmp_path / "out" / "rows.jsonl").read_text().startswith(lines)
    code, _, err = station(*told, "--repeats", 1)
    assert code == 1 and "it has 2 repeats, the new one 1" in err and len(err.splitlines()) <= 5
    assert json.loads(station(*told, "--repeats", 1, "--force")[1])["fits"] == 16


@pytest.mark.parametrize(
    ("flags", "said"),
    [
        (("--trees", "nope"), "no tree 'nope'; packaged ones are"),
        (("--methods", "papre"), "method 'papre' is unknown; choose one of station, paper"),
        (("--methods", ""), "method '' is unknown"),
        (("--noise", "loud"), "noise 'loud' is unknown; choose one of uniform, gaussian"),
        (("--noise-translation-m", "nan"), "noise of translation [m] is nan"),
        (("--noise-translation-m", "-1"), "noise of translation [m] is -1"),
        (("--noise-translation-m", "0.2,0.1"), "want each louder than the last"),
        (("--noise-translation-m", "1,2", "--noise-rotation-rad", "1,2,3"), "have 2 of translation, 3 of rotation"),
        (("--noise-translation-m", "0.1;0.2"), "want numbers with commas between them"),
        (("--inflation", ""), "--inflation is ''; want numbers"),
        (("--inflation", "0,0.5"), "want whole numbers"),
        (("--inflation", "3,1"), "have 1 after 3; want rising numbers"),
        (("--repeats", "0"), "repeats is 0; want a whole number, 1 or more"),
        (("--frames", "0"), "frames: have 0"),
        (("--seed", "-1"), "seed is -1"),
        (("--motion", "hop"), "motion 'hop' is unknown; choose one of walk, smooth"),
        (("--outliers", "1"), "share of outliers is 1"),
        (("--planar",), "experiment1"),
        (("--workers", "0"), "workers: have 0"),
        (("--executor", "somewhere"), "executor 'somewhere' is no address"),
        (("--executor", "tcp://127.0.0.1:9", "--workers", "2"), "a Dask cluster has the workers that it has"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, tuple) else "",
)
def test_bad_grids_are_one_clear_error_and_leave_no_folder(
    station: Station, tmp_path: Path, flags: tuple[str, ...], said: str
):
    code, out, err = station("sweep", "--out", tmp_path / "out", *flags)
    assert (code, out) == (1, "") and said in err and err.startswith("error: ")
    assert len(err.splitlines()) <= 5 and not (tmp_path / "out").exists()


@contextmanager
def sweeping(out: Path, door: Path, repeats: int, *more: str) -> Generator[subprocess.Popen[str], None, None]:
    """The command as a program with a process group of its own, with a row or more on the disk."""
    grid = (
        "--trees",
        str(door),
        "--methods",
        "station",
        "--frames",
        "20",
        "--inflation",
        "0",
        "--repeats",
        str(repeats),
    )
    command = (*COMMAND, "--out", str(out), *grid, "--noise-translation-m", "0.001", *more)
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    with subprocess.Popen(command, cwd=ROOT, text=True, start_new_session=True, **pipes) as program:  # type: ignore[call-overload]
        try:
            until(lambda: lines(out) > 0 or program.poll() is not None)
            yield program
        finally:
            with suppress(ProcessLookupError):
                os.killpg(program.pid, signal.SIGKILL)


def until(come: Callable[[], bool]) -> None:
    """Wait for it."""
    end_s = time.monotonic() + WAIT_S
    while not come():
        assert time.monotonic() < end_s
        time.sleep(0.05)


def lines(out: Path) -> int:
    """Rows on the disk."""
    rows = out / "rows.jsonl"
    return rows.read_bytes().count(b"\n") if rows.exists() else 0


def nobody_is_left(group: int) -> bool:
    """Whether no process of the group lives."""
    with suppress(ProcessLookupError):
        os.killpg(group, 0)
        return False
    return True


def workers_of(program: int) -> list[int]:
    """Processes that the program spawned to fit."""
    found: list[int] = []
    for path in Path("/proc").iterdir():
        with suppress(OSError, ValueError, IndexError):
            parent = int((path / "stat").read_text().rsplit(")", 1)[1].split()[1])
            if parent == program and b"spawn_main" in (path / "cmdline").read_bytes():
                found.append(int(path.name))
    return found


def test_after_ctrl_c_the_exit_code_is_130_nothing_runs_on_and_what_is_done_stays(tmp_path: Path, door: Path):
    out = tmp_path / "out"
    with sweeping(out, door, 10_000, "--workers", "2") as program:
        os.killpg(program.pid, signal.SIGINT)  # as a terminal does
        printed, said = program.communicate(timeout=WAIT_S)
        assert program.returncode == 130 and "Traceback" not in said and not printed
        until(lambda: nobody_is_left(program.pid))
    kept = read_sweep(out)
    assert f"{len(kept.rows)} of 10000 fits are kept in {out}; run the same command again to go on" in said
    assert not kept.notices and len(kept.rows) > 0
    assert len((out / "sweep.csv").read_text().splitlines()) == 1 + len(kept.rows)
    row = kept.rows[-1]
    assert numbers(row) == numbers(run_cell(row.cell, DOOR.tree).row)


def test_a_killed_sweep_leaves_no_worker_behind_and_is_gone_on_with(tmp_path: Path, door: Path):
    out = tmp_path / "out"
    with sweeping(out, door, 12, "--workers", "1") as program:
        program.kill()
        program.wait()
        until(lambda: nobody_is_left(program.pid))
    before = read_sweep(out).rows
    assert 0 < len(before) < 12
    with sweeping(out, door, 12, "--workers", "1") as program:
        _, said = program.communicate(timeout=WAIT_S)
        assert program.returncode == 0, said
    after = read_sweep(out)
    assert after.complete and [numbers(row) for row in before] == [numbers(row) for row in after.rows[: len(before)]]
    assert lines(out) == 12


def test_a_worker_that_is_killed_costs_no_row(tmp_path: Path, door: Path):
    out = tmp_path / "out"
    with sweeping(out, door, 24, "--workers", "2") as program:
        os.kill(workers_of(program.pid)[0], signal.SIGKILL)
        _, said = program.communicate(timeout=WAIT_S)
        assert program.returncode == 0 and "Traceback" not in said
    assert read_sweep(out).complete and lines(out) == 24
