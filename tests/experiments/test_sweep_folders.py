"""A sweep's folder: rows stay whatever ends the program, tables have DESIGN's columns, grids don't mix."""

import csv
import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from station.errors import InvalidFile, OutputExists, StationError
from station.experiments import JointRow, NoiseLevel, read_sweep, run_cell
from station.experiments.rows import parse_row, row_line, rows_csv, rows_table
from station.experiments.store import Store
from tests.experiments.made_sweeps import DOOR, LEVELS, numbers, outcome_of, small_grid

DESIGN = (
    "method noise_translation_m noise_rotation_rad inflation repeat seed structure_correct types_correct axis_error_deg"
)
GRID = small_grid()
CELLS = GRID.cells()


def begun(folder: Path, count: int = 3) -> Path:
    """A folder with some rows, and its file of rows."""
    with Store.open(folder, GRID) as store:
        store.add([outcome_of(cell) for cell in CELLS[:count]])
    return folder / "rows.jsonl"


def done(folder: Path) -> list[object]:
    return [row.cell.key for row in read_sweep(folder).rows]


def test_rows_are_read_as_they_were_written():
    outcome = run_cell(CELLS[0], DOOR.tree, keep=True)
    line = row_line(outcome.row)
    again = parse_row(line, {CELLS[0].key: CELLS[0]}, "rows.jsonl, line 1")
    assert numbers(again) == numbers(outcome.row) and again.fit_s == outcome.row.fit_s and line.endswith("\n")
    assert again.joints[0].true_type == "revolute" and "numpy" in again.versions


def test_a_row_handed_over_is_on_the_disk(tmp_path: Path):
    with Store.open(tmp_path, GRID) as store:
        store.add([outcome_of(CELLS[0])])
        assert done(tmp_path) == [CELLS[0].key]  # another reader, while the folder is open


def test_what_is_done_is_not_missing_when_the_folder_is_opened_again(tmp_path: Path):
    begun(tmp_path)
    with Store.open(tmp_path, GRID) as store:
        assert [cell.key for cell in store.missing()] == [cell.key for cell in CELLS[3:]]


def test_a_row_that_comes_twice_counts_once(tmp_path: Path):
    rows = begun(tmp_path)
    with Store.open(tmp_path, GRID) as store:
        store.add([outcome_of(CELLS[0]), outcome_of(CELLS[4])])
    assert len(rows.read_text().splitlines()) == 4
    rows.write_text(rows.read_text() + rows.read_text())
    assert len(read_sweep(tmp_path).rows) == 4


@pytest.mark.parametrize("cut", [1, 40, None], ids=["its end", "half of it", "an end of zeros"])
def test_a_line_torn_by_a_kill_is_taken_away_with_a_notice_and_its_fit_made_again(tmp_path: Path, cut: int | None):
    rows = begun(tmp_path)
    whole = rows.read_bytes()
    rows.write_bytes(whole + b"\0" * 4096 if cut is None else whole[:-cut])
    kept = 3 if cut is None else 2
    assert len(read_sweep(tmp_path).rows) == kept  # only read: nothing changes
    with Store.open(tmp_path, GRID) as store:
        (notice,) = store.notices
        assert "rows.jsonl: its end was torn" in notice
        store.add([outcome_of(cell) for cell in CELLS[kept:]])
        assert not store.missing()
    again = read_sweep(tmp_path)
    assert again.complete and not again.notices


def test_a_line_that_no_kill_can_have_spoilt_is_an_error_that_names_it(tmp_path: Path):
    rows = begun(tmp_path)
    lines = rows.read_text().splitlines(keepends=True)
    rows.write_text(lines[0] + "what is this\n" + lines[2])
    with pytest.raises(InvalidFile, match=r"rows\.jsonl, line 2 is no row of a sweep"):
        Store.open(tmp_path, GRID)
    rows.write_text(lines[0].replace('"repeat": 0', '"repeat": 7'))
    with pytest.raises(InvalidFile, match=r"rows\.jsonl, line 1: no such fit is in the grid"):
        read_sweep(tmp_path)


def test_another_grid_is_refused_and_changes_nothing(tmp_path: Path):
    begun(tmp_path)
    before = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    with pytest.raises(StationError, match=r"another grid: its seed is 0, the new one's 1\n.*--force"):
        Store.open(tmp_path, replace(GRID, seed=1))
    assert {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()} == before


def test_a_sweep_that_has_no_rows_yet_gives_way_to_another_grid(tmp_path: Path):
    begun(tmp_path, count=0)
    with Store.open(tmp_path, replace(GRID, seed=1)) as store:
        assert len(store.missing()) == len(GRID)
    assert read_sweep(tmp_path).grid.seed == 1


def test_a_grid_with_more_of_everything_goes_on_with_what_is_done(tmp_path: Path):
    begun(tmp_path)
    more = replace(GRID, repeats=3, noise=(*LEVELS, NoiseLevel(0.1, 0.2)))
    with Store.open(tmp_path, more) as store:
        assert len(store.missing()) == len(more) - 3
    assert len(read_sweep(tmp_path).grid) == len(more)
    with pytest.raises(StationError, match="another grid"):  # there is no way back
        Store.open(tmp_path, GRID)


def test_force_begins_anew_and_leaves_what_is_no_sweeps(tmp_path: Path):
    begun(tmp_path)
    (tmp_path / "notes.txt").write_text("mine")
    with Store.open(tmp_path, replace(GRID, seed=1), force=True) as store:
        assert store.done == 0
    assert (tmp_path / "notes.txt").read_text() == "mine" and not read_sweep(tmp_path).rows


def test_a_folder_with_other_things_is_refused(tmp_path: Path):
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(OutputExists, match="isn't empty"):
        Store.open(tmp_path, GRID)
    assert [path.name for path in tmp_path.iterdir()] == ["notes.txt"]
    with pytest.raises(InvalidFile, match=r"holds no sweep: it has no sweep\.json"):
        read_sweep(tmp_path)


def test_a_folder_in_which_a_sweep_was_killed_at_its_first_breath_is_taken(tmp_path: Path):
    (tmp_path / "rows.jsonl").touch()
    (tmp_path / "trees").mkdir()
    with Store.open(tmp_path, GRID) as store:
        assert not store.done


def test_two_programs_do_not_write_one_sweep(tmp_path: Path):
    with Store.open(tmp_path, GRID), pytest.raises(StationError, match="another program is writing the sweep"):
        Store.open(tmp_path, GRID)
    Store.open(tmp_path, GRID).close()


def test_no_row_is_lost_when_the_program_is_killed_while_it_writes(tmp_path: Path):
    """A program that tells each row that `add` has taken is killed in the midst of it."""
    code = (
        "import sys; from pathlib import Path; from station.experiments.store import Store\n"
        "from tests.experiments.made_sweeps import outcome_of, small_grid\n"
        "store = Store.open(Path(sys.argv[1]), small_grid(repeats=2000))\n"
        "for cell in store.missing():\n"
        "    store.add([outcome_of(cell)]); print(cell.seed, flush=True)\n"
    )
    with subprocess.Popen([sys.executable, "-c", code, str(tmp_path)], stdout=subprocess.PIPE, text=True) as program:
        assert program.stdout is not None
        told = [int(program.stdout.readline()) for _ in range(40)]
        program.kill()
        told += [int(line) for line in program.stdout if line.endswith("\n")]
    kept = {row.cell.seed for row in read_sweep(tmp_path).rows}
    assert kept >= set(told) and len(kept) <= len(told) + 1
    Store.open(tmp_path, small_grid(repeats=2000)).close()


def test_the_table_has_designs_columns_first_in_both_forms(tmp_path: Path):
    rows = [run_cell(CELLS[0], DOOR.tree).row, *(outcome_of(cell).row for cell in CELLS[1:3])]
    failed = outcome_of(CELLS[3]).row
    rows.append(replace(failed, structure_correct=False, axis_error_deg=None, error='no, "never"\nagain'))
    table = list(csv.DictReader(rows_csv(rows).splitlines(keepends=True)))
    assert list(table[0])[:9] == DESIGN.split()
    parquet = rows_table(rows)
    assert parquet.column_names == list(table[0])
    assert [line["structure_correct"] for line in table] == ["true", "true", "true", "false"]
    assert table[3]["axis_error_deg"] == "" and table[3]["error"] == 'no, "never"\nagain'
    assert json.loads(table[0]["joints"])[0]["found_type"] == "revolute"
    pq.write_table(parquet, tmp_path / "a.parquet")
    told = pq.read_table(tmp_path / "a.parquet").to_pylist()
    assert [float(line["axis_error_deg"]) for line in table[:3]] == [line["axis_error_deg"] for line in told[:3]]
    assert told[3]["axis_error_deg"] is None and told[0]["error"] is None and told[0]["frames"] == 20
    assert JointRow(**told[0]["joints"][0]) == rows[0].joints[0]
    assert [int(line["seed"]) for line in table] == [line["seed"] for line in told] == [cell.seed for cell in CELLS[:4]]


def test_rows_of_different_versions_are_told(tmp_path: Path):
    begun(tmp_path)
    assert not read_sweep(tmp_path).notices
    later = outcome_of(CELLS[3])
    with Store.open(tmp_path, GRID) as store:
        store.add([replace(later, row=replace(later.row, versions="numpy 9"))])
        assert store.sweep().notices == read_sweep(tmp_path).notices
    (notice,) = read_sweep(tmp_path).notices
    assert "made up; numpy 9" in notice


def test_tables_whose_columns_are_all_blank_have_their_types(tmp_path: Path):
    row = replace(outcome_of(CELLS[0]).row, axis_error_deg=None)
    types = dict(zip(rows_table([row]).column_names, map(str, rows_table([row]).schema.types), strict=True))
    assert (types["axis_error_deg"], types["error"], types["seed"]) == ("double", "string", "int64")


def test_a_disk_that_takes_nothing_more_is_told_with_what_is_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    with Store.open(tmp_path, GRID) as store:
        store.add([outcome_of(CELLS[0])])

        def full(_: int) -> None:
            raise OSError(28, "No space left on device")

        monkeypatch.setattr("os.fsync", full)
        with pytest.raises(StationError, match=r"No space left on device\n1 fits are kept; run the same command"):
            store.add([outcome_of(CELLS[1])])
