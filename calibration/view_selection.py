"""Which frames of a moving board become views, and which view to show next, in words."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calibration.board_detection import BoardFinder, BoardView, Grey, grey_of
from calibration.boards import CharucoBoard
from calibration.camera_calibration import Shot, is_telling
from calibration.intrinsics import FloatArray
from calibration.verdict import BLUR_PX, ninths
from calibration.view_quality import ViewQuality, assess_view, cover, moved_px

# A board is still when its corners moved less than this between two frames, so many times in a row; as a share of the
# image's width, about 1 px of 640.
STILL_SHARE = 1.6e-3
STILL_FRAMES = 3
# Blur of edges with which a view is taken: the limit of a good one, or near the sharpest that this camera showed.
NEAR_SHARPEST = 1.25
# A view is new if it differs from each taken one by one of these steps, or the root of their squares.
STEP_PLACE = 0.14  # of the image's diagonal
STEP_TILT_RAD = np.radians(14.0)
STEP_LOG_SPAN = 0.3
STEP_ROLL_RAD = np.radians(40.0)
# What a set of views should have.
WANTED_VIEWS = 15
WANTED_PER_WAY = 2
TILTED_RAD = np.radians(20.0)
NEAR_SPAN, WANTED_NEAR = 0.5, 4
MOST_EMPTY = 0.25
FULL_CELL = 8  # corners beyond which a cell of the image wants no more
# Whither the board's front is turned, in the image: x right, y down.
WAYS = {
    "its right edge turned away": (1.0, 0.0),
    "its left edge turned away": (-1.0, 0.0),
    "its lower edge turned away": (0.0, 1.0),
    "its upper edge turned away": (0.0, -1.0),
}


@dataclass(frozen=True, eq=False)
class Look:
    """What became of one frame: whether it was taken as a view, else why not; what it shows."""

    taken: bool
    why: str
    view: BoardView
    quality: ViewQuality | None


class ViewSelector:
    """Looks at one frame after another and takes those that add something. Not for two threads at once.

    Args:
        board: what is looked for.
        wait_for_rest: take a view only when the board is still; for frames that follow each other.
        every: take every image that shows the board, whatever the others show: for images that a person chose.
    """

    def __init__(self, board: CharucoBoard, *, wait_for_rest: bool = True, every: bool = False) -> None:
        self._board = board
        self._finder = BoardFinder(board)
        self._wait_for_rest, self._every = wait_for_rest, every
        self._last: BoardView | None = None
        self._still = 0
        self._sharpest_px = np.inf
        self.shots: list[Shot] = []
        self.frames = 0
        self.frames_with_board = 0

    def look(self, image: Grey, name: str) -> Look:
        """Look at the next frame, an 8-bit image, grey or BGR; `name` is that of the view if it becomes one."""
        grey = grey_of(image)
        view = self._finder.find(grey)
        self.frames += 1
        moved = np.inf if self._last is None else moved_px(self._last, view)
        self._last = view
        if not is_telling(view, self._board):
            self._still = 0
            return Look(False, "no board" if not len(view) else f"only {len(view)} corners of the board", view, None)
        self.frames_with_board += 1
        self._still = self._still + 1 if moved <= STILL_SHARE * view.size_px[0] else 0
        quality = assess_view(view, grey, self._board)
        self._sharpest_px = min(self._sharpest_px, quality.blur_px)
        why = "" if self._every else self._objection(quality)
        if why:
            return Look(False, why, view, quality)
        self.shots.append(Shot(name, grey.copy(), view, quality))
        self._still = 0
        return Look(True, f"view {len(self.shots)}", view, quality)

    def _objection(self, quality: ViewQuality) -> str:
        if self._wait_for_rest and self._still < STILL_FRAMES:
            return "hold it still"
        if not quality.blur_px <= max(BLUR_PX[0], NEAR_SHARPEST * self._sharpest_px):
            return f"blurred ({quality.blur_px:.1f} px)"
        near = [k for k, shot in enumerate(self.shots) if _steps(quality, shot) < 1]
        return f"too much like view {near[0] + 1}" if near else ""

    @property
    def cover(self) -> FloatArray:
        """(rows, columns) corners of all views in each cell of the image."""
        return cover([shot.view for shot in self.shots])

    @property
    def complete(self) -> bool:
        """Whether the views are enough: in number, tilts, nearness and places."""
        return len(self.shots) >= WANTED_VIEWS and not self._lacking()

    def advice(self) -> str:
        """The view to show next, in words; empty where nothing is missing."""
        if not self.shots:
            return "hold the board before the camera, so that it fills about half of the image"
        where = self._emptiest_region()
        way = min(WAYS, key=lambda name: self._tilted(name))
        near = sum(shot.quality.span >= NEAR_SPAN for shot in self.shots)
        distance = "nearer, so that it fills the image" if near < WANTED_NEAR else "about as near as this"
        if self.complete:
            return ""
        return f"{where}, {way} by 30 to 40 deg, {distance}"

    def _lacking(self) -> bool:
        few = any(self._tilted(name) < WANTED_PER_WAY for name in WAYS)
        return few or float(np.mean(np.asarray(self.cover == 0))) > MOST_EMPTY

    def _tilted(self, way: str) -> int:
        """How many views are tilted that way."""
        direction = np.array(WAYS[way])
        return sum(
            shot.quality.tilt_rad >= TILTED_RAD and float(shot.quality.facing @ direction) > np.cos(np.pi / 4)
            for shot in self.shots
        )

    def _emptiest_region(self) -> str:
        empty = {name: float(np.mean(np.minimum(cells, FULL_CELL))) for name, cells in ninths(self.cover).items()}
        name = min(empty, key=lambda each: empty[each])
        return (
            "in the middle" if name == "middle" else f"at the {name}" if name in ("left", "right") else f"in the {name}"
        )


def _steps(quality: ViewQuality, shot: Shot) -> float:
    """How different a view is from one that was taken, in steps that make it a new one."""
    other = shot.quality
    diagonal = float(np.hypot(*shot.view.size_px))
    place = float(np.linalg.norm(quality.centre_px - other.centre_px)) / (STEP_PLACE * diagonal)
    lean = quality.tilt_rad * quality.facing - other.tilt_rad * other.facing
    turn = np.abs(np.angle(np.exp(1j * (quality.roll_rad - other.roll_rad))))
    span = np.log(quality.span / other.span) / STEP_LOG_SPAN
    return float(np.linalg.norm([place, float(np.linalg.norm(lean)) / STEP_TILT_RAD, span, turn / STEP_ROLL_RAD]))
