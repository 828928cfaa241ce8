"""The scene as flat rectangles: where they are, which way they face, and which part of the image they can touch."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from station.logs import FloatArray
from station.simulate.rays import distorted
from station.simulate.scene import Box, CameraOptics, Plate

IntArray = NDArray[np.int64]

# Relative. A plate's inverse depth is raised by this (0.35 mm at 0.7 m), so that a plate stuck flush on a box shows.
PLATE_CREDIT = 5e-4
# Relative. Each quad is a little nearer than the one before it: of two in one plane the later shows, whatever is drawn
# first. Well above the rounding of single precision.
ORDER_CREDIT = 2e-6
# Metres. What is nearer than this to the camera's centre plane is behind it.
NEAR_M = 1e-3
# Metres. A quad is edge-on, and not drawn, if the camera is nearer than this to its plane.
EDGE_ON_M = 1e-6
# Points along each edge of an outline, and pixels around it, for edges that the distortion bends.
EDGE_POINTS = 16
REGION_MARGIN_PX = 2
# Normalised image plane. Room around the field of view in which outlines are kept.
VIEW_MARGIN = 0.02
# Linear light that white paper reflects.
PAPER = 0.9

CORNERS = np.array([[-1.0, 1.0], [1.0, 1.0], [1.0, -1.0], [-1.0, -1.0]])


@dataclass(frozen=True, eq=False, slots=True)
class Quads:
    """Q rectangles, each centred on the xy plane of its own frame and facing its +z.

    Attributes:
        body: (Q,) row in `T_cam_body`.
        T_body_quad: (Q, 4, 4).
        half_m: (Q, 2) half lengths along x and y.
        albedo_bgr: (Q, 3) reflected part of the light, linear.
        plates: Q plates, None where the quad is a box's face.
        credit: (Q,) factor on the inverse depth that decides between quads in one plane.
    """

    body: IntArray
    T_body_quad: FloatArray
    half_m: FloatArray
    albedo_bgr: FloatArray
    plates: tuple[Plate | None, ...]
    credit: FloatArray


def _frame(R: FloatArray, t: FloatArray) -> FloatArray:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R, t
    return T


def _face_frames(size_m: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Frames (6, 4, 4) of a box's faces, z outward, and their half lengths (6, 2)."""
    frames, halves = np.empty((6, 4, 4)), np.empty((6, 2))
    for face in range(6):  # once a box, when the scene is built
        axis, sign = face // 2, 1 - 2 * (face % 2)
        x, y = np.eye(3)[(axis + 1) % 3], np.eye(3)[(axis + 2) % 3] * sign
        z = np.cross(x, y)
        frames[face] = _frame(np.stack([x, y, z], axis=1), z * size_m[axis] / 2)
        halves[face] = size_m[(axis + 1) % 3] / 2, size_m[(axis + 2) % 3] / 2
    return frames, halves


def scene_quads(plates: Sequence[Plate], boxes: Sequence[Box]) -> Quads:
    """The scene's rectangles: six a box, then one a plate."""
    body: list[int] = []
    poses: list[FloatArray] = []
    halves: list[FloatArray] = []
    albedos: list[FloatArray] = []
    for box in boxes:
        frames, half = _face_frames(box.size_m)
        body += [box.body] * 6
        poses += list(box.T_body_box @ frames)
        halves += list(half)
        albedos += [(np.array(box.colour_bgr) / 255.0) ** 2.2] * 6
    for plate in plates:
        body.append(plate.body)
        poses.append(plate.T_body_marker)
        halves.append(np.full(2, plate.size_m / 2 + plate.margin_m))
        albedos.append(np.full(3, PAPER))
    count, faces = len(body), 6 * len(boxes)
    credit = 1 + ORDER_CREDIT * np.arange(count) + PLATE_CREDIT * (np.arange(count) >= faces)
    return Quads(
        body=np.array(body, dtype=np.int64),
        T_body_quad=np.array(poses).reshape(count, 4, 4),
        half_m=np.array(halves).reshape(count, 2),
        albedo_bgr=np.array(albedos).reshape(count, 3),
        plates=(None,) * faces + tuple(plates),
        credit=credit,
    )


def facing(T_cam_quad: FloatArray) -> NDArray[np.bool_]:
    """Whether the camera is in front of each quad's plane, (Q,)."""
    return np.sum(T_cam_quad[:, :3, 2] * T_cam_quad[:, :3, 3], axis=-1) < -EDGE_ON_M


def ray_matrices(T_cam_quad: FloatArray, half_m: FloatArray) -> FloatArray:
    """Matrices M (Q, 3, 3) with `M @ (x, y, 1) = (a, b, 1) / depth`, where a, b are -1 to 1 on the quad.

    The point on the plane is `depth * ray = c + u e_x + v e_y`; so `inv([e_x e_y c]) @ ray = (u, v, 1) / depth`.
    """
    columns = T_cam_quad[:, :3, [0, 1, 3]]
    columns = columns * np.stack([half_m[:, 0], half_m[:, 1], np.ones(len(half_m))], axis=-1)[:, None, :]
    return np.linalg.inv(columns).astype(np.float64)


@dataclass(frozen=True, slots=True)
class View:
    """The field of view in normalised coordinates: least and largest x / z, y / z that any ray has."""

    x_min: float
    x_max: float
    y_min: float
    y_max: float

    @property
    def planes(self) -> FloatArray:
        """(5, 4) half spaces `p @ (x, y, z, 1) >= 0`: four sides and the near plane."""
        return np.array([
            [1, 0, -self.x_min, 0], [-1, 0, self.x_max, 0],
            [0, 1, -self.y_min, 0], [0, -1, self.y_max, 0],
            [0, 0, 1, -NEAR_M],
        ])  # fmt: skip


def view_of(ray_x: FloatArray, ray_y: FloatArray) -> View:
    """The field of view of rays of any shape; NaN rays are left out."""
    return View(
        float(np.nanmin(ray_x)) - VIEW_MARGIN, float(np.nanmax(ray_x)) + VIEW_MARGIN,
        float(np.nanmin(ray_y)) - VIEW_MARGIN, float(np.nanmax(ray_y)) + VIEW_MARGIN,
    )  # fmt: skip


def clipped(polygon: FloatArray, planes: FloatArray) -> FloatArray:
    """The part of a convex polygon (V, 3) inside all half spaces (P, 4), by Sutherland and Hodgman; (0, 3) if none."""
    for plane in planes:  # few planes, and only for quads that cross the border of the view
        side = polygon @ plane[:3] + plane[3]
        kept: list[FloatArray] = []
        for k in range(len(polygon)):
            here, before = side[k], side[k - 1]
            if (here >= 0) != (before >= 0):
                kept.append(polygon[k] + (polygon[k - 1] - polygon[k]) * (here / (here - before)))
            if here >= 0:
                kept.append(polygon[k])
        polygon = np.array(kept).reshape(-1, 3)
    return polygon


def _outlines(corners: FloatArray, planes: FloatArray) -> FloatArray:
    """Clipped outlines (Q, V, 3) of quads with corners (Q, 4, 3), the last point repeated; NaN where out of view."""
    side = corners @ planes[:, :3].T + planes[:, 3]
    whole = np.all(side >= 0, axis=(-2, -1))
    outlines = np.full((len(corners), 4 + len(planes), 3), np.nan)
    outlines[whole, :4] = corners[whole]
    outlines[whole, 4:] = corners[whole, 3:]
    outside = np.any(np.all(side < 0, axis=1), axis=-1)
    for k in np.flatnonzero(~whole & ~outside):  # polygons of different lengths; few cross the border
        polygon = clipped(corners[k], planes)
        if len(polygon):
            outlines[k, : len(polygon)] = polygon
            outlines[k, len(polygon) :] = polygon[-1]
    return outlines


def regions(T_cam_quad: FloatArray, half_m: FloatArray, optics: CameraOptics, view: View) -> IntArray:
    """Pixel rectangles (Q, 4) `x0, y0, x1, y1` (ends excluded) beyond which the quads can't show; x1 <= x0 if none."""
    local = np.concatenate([CORNERS * half_m[:, None, :], np.zeros((len(half_m), 4, 1))], axis=-1)
    corners = local @ np.swapaxes(T_cam_quad[:, :3, :3], -1, -2) + T_cam_quad[:, None, :3, 3]
    outlines = _outlines(corners, view.planes)
    rays = outlines[..., :2] / outlines[..., 2:]
    along = (np.arange(EDGE_POINTS) / EDGE_POINTS)[:, None]
    points = rays[:, :, None] + (np.roll(rays, -1, axis=1) - rays)[:, :, None] * along
    u, v = distorted(points[..., 0], points[..., 1], optics.distortion)
    pixels = np.stack([u, v], axis=-1).reshape(len(half_m), u.shape[1] * u.shape[2], 2)
    pixels = pixels * optics.matrix[[0, 1], [0, 1]] + optics.matrix[:2, 2]
    size = np.array(optics.size_px)
    gone = np.isnan(outlines[:, 0, 0])
    pixels[gone] = -np.inf
    low = np.clip(np.floor(pixels.min(axis=1)) - REGION_MARGIN_PX, 0, size)
    high = np.clip(np.ceil(pixels.max(axis=1)) + REGION_MARGIN_PX + 1, 0, size)
    return np.concatenate([low, high], axis=-1).astype(np.int64)
