from pathlib import Path

import pytest

from calibration.boards import CharucoBoard
from station.errors import InvalidFile
from station.formats.board import format_board, parse_board


def test_a_board_is_drawn_and_described_beside_it(station, tmp_path: Path):
    code, out, err = station("board", "--squares", "6x8", "--out", tmp_path / "sheet.pdf")
    assert code == 0 and "1 page" in out and "measure both 100 mm rulers" in err
    board, measured = parse_board((tmp_path / "sheet.toml").read_text("utf-8"), "sheet.toml")
    assert board == CharucoBoard(6, 8, 0.025, 0.0175, "DICT_5X5_100") and not measured
    code, _, err = station("board", "--out", tmp_path / "sheet.pdf")
    assert code == 1 and "sheet.pdf exists" in err
    assert station("board", "--out", tmp_path / "sheet.pdf", "--force")[0] == 0


def test_a_rigs_markers_are_drawn_at_their_sizes(station, tmp_path: Path):
    code, out, _ = station("board", "markers", "--rig", "demo", "--out", tmp_path / "demo.svg")
    assert code == 0 and "demo-1.svg" in out and "2 pages" in out
    text = "".join((tmp_path / f"demo-{k}.svg").read_text("utf-8") for k in (1, 2))
    assert all(f">{n}  50.8 mm  DICT_4X4_50  " in text for n in range(10))


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (["--out", "sheet.png"], 1, "want a file that ends in .pdf or .svg"),
        (["--out", "sheet.pdf", "--square-mm", "40", "--squares", "7x9"], 1, "doesn't fit on A4"),
        (["--out", "sheet.pdf", "--squares", "seven"], 2, "such as 7x10"),
        (["markers", "--out", "sheet.pdf"], 2, "want --rig RIG or --ids"),
        (["markers", "--ids", "9-1", "--out", "sheet.pdf"], 1, "such as 0-9,20"),
        (["markers", "--ids", "60", "--out", "sheet.pdf"], 1, "its ids are 0 to 49"),
        (["markers", "--rig", "nowhere", "--out", "sheet.pdf"], 1, "no rig 'nowhere'"),
    ],
)
def test_what_cannot_be_drawn_is_one_clear_error(station, tmp_path, monkeypatch, arguments, code, message):
    monkeypatch.chdir(tmp_path)
    got, _, err = station("board", *arguments)
    assert got == code and message in err
    assert not list(tmp_path.iterdir())


def test_a_board_file_reads_back_the_same():
    board = CharucoBoard(7, 9, 0.025, 0.0175, "DICT_5X5_100", legacy=True)
    assert parse_board(format_board(board, measured=False), "b") == (board, False)
    printed = board.measured((99.5, 99.8))
    assert parse_board(format_board(printed, measured=True), "b") == (printed, True)
    with pytest.raises(InvalidFile, match=r"b: the 100 mm ruler measures 9\.95 mm"):
        parse_board(format_board(board, measured=False) + "measured_mm = [9.95, 100.0]\n", "b")
