"""Whether a calibration can be trusted, in words: good, usable or bad, why, and what to do about it.

The limits are choices, named below. What they are made for: a marker of 50 mm at 0.6 m, whose distance is wrong by the
same share as the focal length, and whose place is wrong by a tenth of a millimetre for a tenth of a pixel.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from calibration.camera_fit import CameraFit, hats, parameter_jacobian, prior_std
from calibration.held_out import HeldOut
from calibration.intrinsics import CameraModel, FloatArray, project, project_jacobian
from calibration.view_quality import ViewQuality

# Limits (good up to, usable up to).
FOCAL_SHARE = (0.003, 0.01)  # standard deviation of the focal lengths
MAP_PX = (0.8, 2.0)  # standard deviation of where the camera has a point, at the worst place of the image
RMS_PX = (0.4, 1.0)
HELD_OUT_RATIO = (1.6, 3.0)  # of the RMS of views left out to that of all
HELD_OUT_FLOOR_PX = 0.05  # RMS below which a ratio says nothing
BLUR_PX = (1.5, 2.2)  # of edges, median of the views
EMPTY_SHARE = (0.35, 0.6)  # of the image's cells that no corner fell into
VIEWS = (10, 6)
TILTED = (5, 3)  # views
TILTED_RAD = np.radians(15.0)
MARKER_SHARE = (0.06, 0.12)  # how far the markers' sizes are from those described
# Views that are tilted the same way only count as one way of tilting within this angle.
WAYS_RAD = np.radians(60.0)
PRIOR_SHARE = 0.5  # of the prior's standard deviation: the views said less than what any camera is like
# Places of the image at which the uncertainty of the map is looked at.
GRID = (9, 7)
LARGEST_RAY = 3.0
REGIONS = (
    ("upper left", "upper middle", "upper right"),
    ("left", "middle", "right"),
    ("lower left", "lower middle", "lower right"),
)


class Grade(IntEnum):
    """How good something is; the worst of all decides."""

    GOOD = 0
    USABLE = 1
    BAD = 2

    @property
    def word(self) -> str:
        """In lower case."""
        return self.name.lower()


@dataclass(frozen=True)
class Remark:
    """One thing that is less than good: how bad, what it is, what to do."""

    grade: Grade
    what: str
    do: str


@dataclass(frozen=True)
class Verdict:
    """The verdict in words."""

    remarks: tuple[Remark, ...]

    @property
    def grade(self) -> Grade:
        """The worst remark's; good if there is none."""
        return max((remark.grade for remark in self.remarks), default=Grade.GOOD)


def graded(value: float, limits: tuple[float, float]) -> Grade:
    """Good up to the first limit, usable up to the second; what is no number is bad."""
    return Grade.GOOD if value <= limits[0] else Grade.USABLE if value <= limits[1] else Grade.BAD


def judge(
    fit: CameraFit,
    held_out: HeldOut | None,
    qualities: Sequence[ViewQuality],
    cover: FloatArray,
    marker_share: float | None = None,
) -> Verdict:
    """The verdict on a calibration.

    Args:
        qualities: of each view.
        cover: (rows, columns) corners in each cell of the image.
        marker_share: measured side of the markers by that described; None where not measured.
    """
    remarks = [
        *_on_board(marker_share),
        *_on_sharpness(qualities),
        *_on_number(len(qualities)),
        *_on_tilt(qualities),
        *_on_cover(cover),
        *_on_numbers(fit),
        *_on_residuals(fit, held_out),
    ]
    return Verdict(tuple(sorted((each for each in remarks if each.grade), key=lambda each: -each.grade)))


def _on_board(marker_share: float | None) -> list[Remark]:
    if marker_share is None:
        return []
    what = (
        f"the markers are {marker_share:.2f} times as large, against the squares, as the board's description says: "
        "it is another board's"
    )
    do = "take the description printed on the sheet (--board charuco:...), or measure its squares and markers"
    return [Remark(graded(abs(marker_share - 1), MARKER_SHARE), what, do)]


def _on_sharpness(qualities: Sequence[ViewQuality]) -> list[Remark]:
    blur = np.array([quality.blur_px for quality in qualities])
    median = float(np.nanmedian(blur)) if np.any(np.isfinite(blur)) else 0.0
    blurred = int(np.sum(blur > BLUR_PX[0]))
    grade = graded(median, BLUR_PX)
    if grade is Grade.GOOD and 4 * blurred > len(blur):
        grade = Grade.USABLE
    what = (
        f"{blurred} of {len(blur)} views are blurred (edges spread over {median:.1f} px, want {BLUR_PX[0]:g} or less)"
    )
    do = "focus the camera and lock the focus, hold the board still, use more light or a shorter exposure"
    return [Remark(grade, what, do)]


def _on_number(count: int) -> list[Remark]:
    grade = Grade.GOOD if count >= VIEWS[0] else Grade.USABLE if count >= VIEWS[1] else Grade.BAD
    return [Remark(grade, f"only {count} views", "take 15, each at another place and tilt")]


def _on_tilt(qualities: Sequence[ViewQuality]) -> list[Remark]:
    tilted = [quality for quality in qualities if quality.tilt_rad >= TILTED_RAD]
    count, most = len(tilted), np.degrees(max((quality.tilt_rad for quality in qualities), default=0.0))
    grade = Grade.GOOD if count >= min(TILTED[0], len(qualities)) else Grade.USABLE if count >= TILTED[1] else Grade.BAD
    do = "add views with the board tilted by 30 to 45 deg: left, right, up and down"
    if grade:
        what = (
            f"{count} of {len(qualities)} views are tilted, the most by {most:.0f} deg: the rest tell no focal length"
        )
        return [Remark(grade, what, do)]
    facing = np.array([quality.facing for quality in tilted])
    if np.all(facing @ facing[0] > np.cos(WAYS_RAD)):
        return [Remark(Grade.USABLE, "all tilted views are tilted the same way", do)]
    return []


def _on_cover(cover: FloatArray) -> list[Remark]:
    empty = float(np.mean(np.asarray(cover == 0)))
    regions = empty_regions(cover)
    where = ", ".join(regions) or "scattered"
    what = f"{empty:.0%} of the image never shows a corner of the board ({where}): distortion is guessed there"
    return [Remark(graded(empty, EMPTY_SHARE), what, "add views there, and some from near that fill the image")]


def empty_regions(cover: FloatArray) -> list[str]:
    """The ninths of the image, by name, of which more than half the cells are empty."""
    return [name for name, cells in ninths(cover).items() if np.mean(np.asarray(cells == 0)) > 0.5]


def ninths(cover: FloatArray) -> dict[str, FloatArray]:
    """The cells of each ninth of the image, by its name."""
    bands = [np.array_split(band, len(REGIONS[0]), axis=1) for band in np.array_split(cover, len(REGIONS), axis=0)]
    return {name: bands[r][c] for r, names in enumerate(REGIONS) for c, name in enumerate(names)}


def _on_numbers(fit: CameraFit) -> list[Remark]:
    camera, std = fit.camera, fit.std
    focal = camera.matrix[[0, 1], [0, 1]]
    share = float(np.max(std[:2] / focal))
    places = map_std_px(fit)
    worst_px = float(np.nanmax(places))
    remarks = [
        Remark(
            graded(share, FOCAL_SHARE),
            f"the focal length is known to {share:.1%} only, and so is every distance",
            "add views with the board tilted by 30 to 45 deg, near enough to fill half the image",
        ),
        Remark(
            graded(worst_px, MAP_PX),
            f"where the camera has a point is known to {worst_px:.1f} px only at the worst place of the image",
            "add views that reach the image's borders and corners",
        ),
    ]
    open_ones = std[:5] > PRIOR_SHARE * prior_std(camera)[:5]
    if np.any(open_ones):
        names = ", ".join(np.array(["fx", "fy", "cx", "cy", "k1"])[open_ones])
        what = f"the views don't tell {names}: what is written is what is common for cameras"
        remarks.append(Remark(Grade.BAD, what, "add tilted views all over the image"))
    return remarks


def _on_residuals(fit: CameraFit, held_out: HeldOut | None) -> list[Remark]:
    rms_px = fit.camera.rms_px or 0.0
    dropped = float(np.mean(~fit.used))
    do = "glue the board flat on something stiff, hold it still, check the board's description and both rulers"
    remarks = [
        Remark(graded(rms_px, RMS_PX), f"corners are {rms_px:.2f} px RMS from where the camera has them", do),
        Remark(graded(dropped, (0.1, 0.3)), f"{dropped:.0%} of the corners fit nowhere and were left out", do),
    ]
    if held_out is not None:
        ratio = held_out.rms_px / max(rms_px, HELD_OUT_FLOOR_PX)
        what = f"views left out are off by {held_out.rms_px:.2f} px RMS, {ratio:.1f} times as far as those fitted"
        remarks.append(Remark(graded(ratio, HELD_OUT_RATIO), what, "take more views, and more different ones"))
    return remarks


def undistorted_rays(camera: CameraModel, px: FloatArray) -> FloatArray:
    """Directions (..., 3) with z = 1 whose images are the pixels (..., 2); NaN where there are none."""
    target = (px - camera.matrix[:2, 2]) / camera.matrix[[0, 1], [0, 1]]
    unit = CameraModel(camera.size_px, np.eye(3), camera.distortion)
    rays = np.concatenate([target, np.ones((*target.shape[:-1], 1))], axis=-1)
    for _ in range(30):  # Newton's method; past the fold of a polynomial there is no solution
        error = project(unit, rays) - target
        J = project_jacobian(unit, rays)[..., :2]
        with np.errstate(all="ignore"):
            det = J[..., 0, 0] * J[..., 1, 1] - J[..., 0, 1] * J[..., 1, 0]
            dx = (J[..., 1, 1] * error[..., 0] - J[..., 0, 1] * error[..., 1]) / det
            dy = (J[..., 0, 0] * error[..., 1] - J[..., 1, 0] * error[..., 0]) / det
        rays[..., :2] -= np.stack([dx, dy], axis=-1)
    off = np.linalg.norm(project(unit, rays) - target, axis=-1)
    return np.where(
        (off < 1e-9)[..., None] & (np.linalg.norm(rays[..., :2], axis=-1) < LARGEST_RAY)[..., None], rays, np.nan
    )


def map_std_px(fit: CameraFit) -> FloatArray:
    """Standard deviation (rows, columns) of where the camera has a direction, over the image; NaN where it has none.

    Less what a turn of the camera would make of it: no view can tell the two apart, and no pose suffers from it.
    """
    camera = fit.camera
    width, height = camera.size_px
    columns, rows = GRID
    u, v = np.meshgrid(np.linspace(0, width - 1, columns), np.linspace(0, height - 1, rows))
    rays = undistorted_rays(camera, np.stack([u, v], axis=-1).reshape(-1, 2))
    seen = np.all(np.isfinite(rays), axis=-1)
    change = parameter_jacobian(camera, rays[seen]).reshape(-1, 9)
    turns = (project_jacobian(camera, rays[seen]) @ hats(rays[seen])).reshape(-1, 3)
    left = change - turns @ np.linalg.pinv(turns) @ change
    variance = np.einsum("ij,jk,ik->i", left, fit.covariance, left).reshape(-1, 2).sum(axis=1)
    std = np.full(len(rays), np.nan)
    std[seen] = np.sqrt(variance)
    return std.reshape(rows, columns)
