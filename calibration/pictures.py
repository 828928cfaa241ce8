"""Pictures for people: which parts of the image the views cover; and images as lossless files."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from calibration.board_detection import BoardView, Grey
from calibration.errors import CalibrationError
from calibration.intrinsics import FloatArray

Picture = np.ndarray[tuple[int, ...], np.dtype[np.uint8]]

WIDTH_PX = 960
MARGIN_PX = 40
# Blue, green, red.
PAPER, INK, GRID_LINE, EMPTY = (255, 255, 255), (60, 60, 60), (215, 215, 215), (225, 225, 250)
HUES = 180  # of OpenCV's 8-bit HSV
GOLDEN = 0.618  # neighbours in time get hues far apart


def encode_png(image: Grey) -> bytes:
    """The PNG of an image; raises CalibrationError for what is no image."""
    done, png = cv2.imencode(".png", image)
    if not done:
        raise CalibrationError(f"an image of shape {image.shape}, {image.dtype} can't be encoded as PNG")
    return png.tobytes()


def cover_picture(views: Sequence[BoardView], cover: FloatArray, title: str) -> Picture:
    """All corners of the views where they are in the image, a colour a view; cells without any are tinted."""
    width, height = views[0].size_px if views else (4, 3)
    scale = WIDTH_PX / width
    size = WIDTH_PX, round(height * scale)
    picture = np.full((size[1] + 2 * MARGIN_PX, size[0] + 2 * MARGIN_PX, 3), 255, np.uint8)
    corner = np.array([MARGIN_PX, MARGIN_PX])
    rows, columns = cover.shape
    for row in range(rows):  # some dozens of cells
        for column in range(columns):
            low = corner + np.array([column * size[0] / columns, row * size[1] / rows])
            high = corner + np.array([(column + 1) * size[0] / columns, (row + 1) * size[1] / rows])
            ends = [tuple(int(v) for v in np.rint(point)) for point in (low, high)]
            if not cover[row, column]:
                cv2.rectangle(picture, ends[0], ends[1], EMPTY, cv2.FILLED)
            cv2.rectangle(picture, ends[0], ends[1], GRID_LINE, 1)
    for number, view in enumerate(views):
        hsv = np.array([[[int(number * GOLDEN * HUES) % HUES, 200, 200]]], np.uint8)
        colour = cv2.cvtColor(hsv, cv2.COLOR_HSV2BGR)[0, 0].tolist()
        for spot in np.rint((view.corners_px + 0.5) * scale + corner).astype(int):
            cv2.circle(picture, (int(spot[0]), int(spot[1])), 3, colour, cv2.FILLED, cv2.LINE_AA)
    end = int(corner[0] + size[0]), int(corner[1] + size[1])
    cv2.rectangle(picture, (MARGIN_PX, MARGIN_PX), end, INK, 1)
    cv2.putText(picture, title, (MARGIN_PX, MARGIN_PX - 12), cv2.FONT_HERSHEY_SIMPLEX, 0.6, INK, 1, cv2.LINE_AA)
    return picture
