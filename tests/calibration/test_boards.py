import re

import cv2
import numpy as np
import pypdfium2 as pdfium
import pytest
import resvg_py

from calibration.boards import CharucoBoard, MarkerSheet, PrintedMarker, load_dictionary, marker_cells, parse_spec
from calibration.errors import CalibrationError
from calibration.pages import PAPERS_MM, Page, pdf, svg
from calibration.sheets import charuco_page, largest_board, marker_pages

BOARD = CharucoBoard(7, 9, 0.025, 0.0175, "DICT_5X5_100")
DPI = 300.0
MM_PER_PX = 25.4 / DPI
# Pixel (0, 0) is the centre of the top-left pixel.
HALF_PX = 0.5


def drawn_pdf(pages: list[Page]) -> list[np.ndarray]:
    """The pages as an independent reader draws them, grey, at DPI."""
    document = pdfium.PdfDocument(pdf(pages, "test"))
    images = [document[k].render(scale=DPI / 72, grayscale=True).to_numpy().squeeze() for k in range(len(document))]
    document.close()
    return images


def drawn_svg(page: Page) -> np.ndarray:
    png = bytes(resvg_py.svg_to_bytes(svg_string=svg(page), dpi=DPI))
    return cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_GRAYSCALE)


@pytest.mark.parametrize("legacy", [False, True])
@pytest.mark.parametrize("squares", [(5, 4), (4, 5), (7, 9), (6, 8)])
def test_the_layout_is_opencvs(squares: tuple[int, int], legacy: bool):
    board = CharucoBoard(*squares, 0.03, 0.02, "DICT_5X5_100", legacy)
    theirs = board.opencv_board()
    atol_m = 1e-8  # OpenCV keeps single precision
    np.testing.assert_allclose(board.corner_points(), theirs.getChessboardCorners(), atol=atol_m)
    np.testing.assert_allclose(board.marker_points(), np.array(theirs.getObjPoints()), atol=atol_m)
    per_square = 60
    size = board.columns * per_square, board.rows * per_square
    picture = theirs.generateImage(size, marginSize=0, borderBits=1)
    mine = np.full(picture.shape, 255, np.uint8)
    for x, y, w, h in np.rint(board.black_rectangles() / board.square_m * per_square).astype(int):
        mine[y : y + h, x : x + w] = 0
    # OpenCV's picture rounds the markers' places: a rim of a pixel may differ.
    core = cv2.erode(np.uint8(255) * (mine != picture), np.ones((3, 3), np.uint8))
    assert not core.any()


@pytest.mark.parametrize("reader", ["pdf", "svg"])
@pytest.mark.parametrize("paper", ["a4", "letter"])
def test_a_printed_board_is_found_by_opencv_at_its_millimetres(paper: str, reader: str):
    board = largest_board(paper, 25.0, 17.5, "DICT_5X5_100")
    page = charuco_page(board, paper)
    image = drawn_pdf([page])[0] if reader == "pdf" else drawn_svg(page)
    assert abs(np.array(image.shape[::-1]) * MM_PER_PX - PAPERS_MM[paper]).max() < 2 * MM_PER_PX
    corners, ids, _, marker_ids = cv2.aruco.CharucoDetector(board.opencv_board()).detectBoard(image)
    assert sorted(ids.ravel()) == list(range(board.corner_count))
    assert len(marker_ids) == board.marker_count
    # pdfium stretches the page to whole pixels.
    mm_per_px = np.array(PAPERS_MM[paper]) / image.shape[::-1] if reader == "pdf" else MM_PER_PX
    seen_mm = (corners.reshape(-1, 2) + HALF_PX) * mm_per_px
    true_mm = 1e3 * board.corner_points()[ids.ravel(), :2] + page.rectangles_mm[:, :2].min(axis=0)
    assert np.abs(seen_mm - true_mm).max() < 0.03  # a third of a pixel of 0.085 mm


@pytest.mark.parametrize("reader", ["pdf", "svg"])
def test_the_rulers_are_100_mm(reader: str):
    page = charuco_page(BOARD, "a4")
    image = drawn_pdf([page])[0] if reader == "pdf" else drawn_svg(page)
    long = [line for line in page.lines if abs(line.x2 - line.x1) + abs(line.y2 - line.y1) > 50]
    across, down = sorted(long, key=lambda line: line.x1 == line.x2)
    row = image[round((across.y1 + 1.0) / MM_PER_PX), : round((across.x2 + 2) / MM_PER_PX)]
    column = image[: round((down.y2 + 2) / MM_PER_PX), round((down.x1 - 1.0) / MM_PER_PX)]
    for profile in (row, column):
        dark = np.flatnonzero(profile < 160)
        assert abs((dark[-1] - dark[0]) * MM_PER_PX - 100.0) < 2 * MM_PER_PX


def test_the_sheet_tells_how_to_use_it_and_asks_not_to_be_scaled():
    content = pdf([charuco_page(BOARD, "a4")], "board (draft)")
    document = pdfium.PdfDocument(content)
    words = document[0].get_textpage().get_text_bounded()
    assert document.get_metadata_value("Title") == "board (draft)"
    document.close()
    assert b"/PrintScaling /None" in content
    spec = re.search(r"--board (\S+)", words)
    assert spec is not None and parse_spec(spec[1]) == BOARD
    assert "7 x 9 squares of 25 mm" in words and "100 mm across" in words


def test_markers_are_printed_at_their_sizes_and_all_found():
    markers = [PrintedMarker(n, 0.0508, f"part_{n}") for n in range(10)] + [
        PrintedMarker(40 + n, 0.02) for n in range(9)
    ]
    pages = marker_pages(MarkerSheet("DICT_4X4_50", tuple(markers)), "letter")
    images = drawn_pdf(pages)
    detector = cv2.aruco.ArucoDetector(load_dictionary("DICT_4X4_50"))
    sides_mm: dict[int, float] = {}
    for image in images:
        corners, ids, _ = detector.detectMarkers(image)
        for marker_id, four in zip(np.ravel(ids), corners, strict=True):
            sides_mm[int(marker_id)] = cv2.arcLength(four.reshape(4, 2), closed=True) / 4 * MM_PER_PX
    want_mm = {marker.id: 1e3 * marker.size_m for marker in markers}
    assert sides_mm.keys() == want_mm.keys()
    assert max(abs(sides_mm[n] - want_mm[n]) for n in want_mm) < 2 * MM_PER_PX  # rough corners


def test_nothing_is_printed_within_a_markers_white_border_but_its_label_below():
    marker = PrintedMarker(7, 0.03)
    (page,) = marker_pages(MarkerSheet("DICT_4X4_50", (marker,)), "a4")
    low, border = page.rectangles_mm[:, :2].min(axis=0), 30.0 / 6
    label = next(text for text in page.texts if text.text.startswith("7  30 mm"))
    assert label.y - label.size > low[1] + 30.0 + border - 0.5
    cut = [line for line in page.lines if line.width == 0.15 and line.y1 > low[1] - border]
    xs = np.array([line.x1 for line in cut] + [line.x2 for line in cut])
    assert np.all((xs <= low[0] - border + 1e-9) | (xs >= low[0] + 30.0 + border - 1e-9))


def test_the_cells_are_opencvs():
    want = load_dictionary("DICT_4X4_50").generateImageMarker(3, 60)[5::10, 5::10] == 0
    np.testing.assert_array_equal(marker_cells("DICT_4X4_50", 3), want)


def test_a_measured_board_is_stretched_by_its_rulers():
    printed = BOARD.measured((97.0, 98.0))
    np.testing.assert_allclose(printed.corner_points()[:, :2], BOARD.corner_points()[:, :2] * [0.97, 0.98])
    np.testing.assert_allclose(printed.marker_points()[..., :2], BOARD.marker_points()[..., :2] * [0.97, 0.98])
    assert printed.spec == BOARD.spec


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: CharucoBoard(2, 9, 0.025, 0.018, "DICT_5X5_100"), "at least 3x3"),
        (lambda: CharucoBoard(7, 9, 0.025, 0.025, "DICT_5X5_100"), "0.3 to 0.9"),
        (lambda: CharucoBoard(7, 9, 0.0, 0.0, "DICT_5X5_100"), "0.3 to 0.9"),
        (lambda: CharucoBoard(15, 15, 0.01, 0.0075, "DICT_5X5_100"), "has 112 markers, DICT_5X5_100 only 100"),
        (lambda: CharucoBoard(7, 9, 0.025, 0.018, "DICT_9X9"), "no marker dictionary 'DICT_9X9'"),
        (lambda: BOARD.measured((80.0, 100.0)), "measures 80 mm; want 90 to 110 mm"),
        (lambda: BOARD.measured((100.0, np.nan)), "want 90 to 110"),
        (lambda: charuco_page(CharucoBoard(7, 9, 0.04, 0.03, "DICT_5X5_100"), "a4"), "doesn't fit on A4"),
        (lambda: charuco_page(BOARD, "b5"), "no paper 'b5'"),
        (lambda: MarkerSheet("DICT_4X4_50", ()), "no markers"),
        (lambda: marker_pages(MarkerSheet("DICT_4X4_50", (PrintedMarker(50, 0.03),)), "a4"), "marker 50 is not in"),
        (lambda: marker_pages(MarkerSheet("DICT_4X4_50", (PrintedMarker(1, 0.3),)), "a4"), "don't fit on A4"),
        (lambda: PrintedMarker(1, 0.0), "size is 0 mm"),
        (lambda: parse_spec("charuco:7by9"), "is no board"),
    ],
)
def test_what_cannot_be_printed_is_refused(make, message: str):
    with pytest.raises(CalibrationError, match=message):
        make()
