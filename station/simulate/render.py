"""Rendered camera frames: marker plates and boxes seen through a real lens, in the order light, blur, gamma, noise.

Backward mapping: each pixel has 2x2 samples, and each sample its exact undistorted ray, once for all frames. A quad's
plane takes a ray to plate coordinates by one 3x3 matrix, whose last row gives the inverse depth, so the depth test is a
comparison. Marker edges are ramps of half a pixel at their exact places; everything else is point-sampled.

From the samples to gamma all values are 16-bit integers and all filters exact, so that what is taken from the cache of
bodies that stand still is the same, bit by bit, as what would be drawn anew.

Under a rolling shutter each row of pixels has its own time. Poses are given at some rows (knots); between two of them
the matrices of a quad change evenly from row to row.

Not modelled: shadows, specular light, depth of focus, vignetting other than the scene's falloff.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from station.errors import InvalidData
from station.logs import FloatArray
from station.simulate.quads import IntArray, facing, ray_matrices, regions, scene_quads, view_of
from station.simulate.rays import sample_rays
from station.simulate.scene import Box, CameraOptics, Plate, check_poses

__all__ = ["Box", "CameraOptics", "Plate", "SceneRenderer"]

Image = NDArray[np.uint8]
Light = NDArray[np.uint16]
Singles = NDArray[np.float32]
Rectangle = tuple[int, int, int, int]

# The value of a sample that reflects all light that falls on it.
FULL = 65535
# Linear light that printed black reflects, as part of what white paper reflects.
INK = 0.04
# Unit vector to the light in camera coordinates (x right, y down): from above, left of and behind the camera.
TO_LIGHT = np.array([-0.40, -0.72, -0.57]) / np.linalg.norm([-0.40, -0.72, -0.57])
# Linear light on a surface turned away from the light, and what the light adds where it falls squarely.
AMBIENT = 0.42
DIRECT = 0.62
# The light falls off towards the corners of the image by this part.
FALLOFF = 0.12
# Texels of a marker's texture per pixel of image. The ramp of an edge is one texel wide: twice the spacing of the
# samples across an edge along rows or columns, so that the mean of a pixel's samples is exact there.
TEXELS_PER_PX = 2.0
MAX_TEXELS = 256
# The wall's display grey and the seed of its faint structure, the same in every scene.
WALL_BGR = (176, 184, 186)
WALL_SEED = 7
# Sigmas. Half width of the blur's kernel.
BLUR_REACH = 3.5


@dataclass(frozen=True, eq=False, slots=True)
class _Draw:
    """All quads of the scene at one instant: their regions (Q, 4), matrices (Q, 3, 3) and light (Q, 3)."""

    visible: NDArray[np.bool_]
    regions: IntArray
    T_cam_quad: FloatArray
    matrices: FloatArray
    light: FloatArray


@dataclass(frozen=True, eq=False, slots=True)
class _Band:
    """The rows `top` to `bottom` (excluded) of the image, drawn from the knots `draws` at its two ends.

    `share` (2 (bottom - top), 1) is each sample row's part of the way from the first knot to the second; None where
    all of the image has one time.
    """

    draws: tuple[_Draw, _Draw]
    top: int
    bottom: int
    share: Singles | None


@dataclass(frozen=True, eq=False, slots=True)
class _Layer:
    """The scene as far as it stands still: the bodies' poses, the pixels, and the pixels developed.

    Inverse depths and light of its samples are in the renderer's buffers.
    """

    poses: dict[int, bytes]
    pixels: Light
    grey: Singles


def _wall(size_px: tuple[int, int]) -> Light:
    """Light (H, W, 3) of a plain wall: a soft gradient, faint blotches and the seams of its panels."""
    width, height = size_px
    blotches = np.random.default_rng(WALL_SEED).normal(size=(8, 10)).astype(np.float32)
    blotches = cv2.resize(blotches, size_px, interpolation=cv2.INTER_CUBIC)
    down = np.linspace(1.04, 0.92, height, dtype=np.float32)[:, None]
    seams = np.where(np.arange(width) % max(width // 5, 8) < 2, np.float32(0.94), np.float32(1.0))
    tone = down * seams * (1 + np.float32(0.012) * blotches)
    albedo = (np.array(WALL_BGR) / 255.0) ** 2.2 * (AMBIENT + 0.5 * DIRECT)
    return np.clip(tone[..., None] * albedo * FULL, 0, FULL).astype(np.uint16)


def _falloff(size_px: tuple[int, int]) -> Light:
    """Factor (H, W, 3) on the light over the image, FULL for 1."""
    width, height = size_px
    x, y = (np.arange(width) + 0.5) / width * 2 - 1, (np.arange(height) + 0.5) / height * 2 - 1
    factor = 1 - FALLOFF / 2 * (x[None, :] ** 2 + y[:, None] ** 2)
    return np.repeat(np.round(factor * FULL).astype(np.uint16)[..., None], 3, axis=2)


def _pixels(samples: Light) -> Light:
    """Light of pixels (H, W, 3): the mean of their 2x2 samples (2H, 2W, 3)."""
    size = samples.shape[1] // 2, samples.shape[0] // 2
    return np.asarray(cv2.resize(samples, size, interpolation=cv2.INTER_AREA), dtype=np.uint16)


def _union(rectangles: IntArray) -> Rectangle:
    """The rectangle around rectangles (N, 4), N > 0."""
    low, high = rectangles[:, :2].min(axis=0), rectangles[:, 2:].max(axis=0)
    return int(low[0]), int(low[1]), int(high[0]), int(high[1])


class SceneRenderer:
    """Renders what a still camera sees of bodies that move. Not for two threads at once.

    Args:
        plates: markers on their plates.
        boxes: everything else. A box's inside is not drawn: a camera in a box sees through it.
        dictionary: name of an ArUco dictionary of OpenCV, such as "DICT_4X4_50".
        optics: the camera.
        seed: of the sensor's noise.

    Raises:
        InvalidData: for a dictionary that OpenCV has not, or a marker id that the dictionary has not.
    """

    def __init__(
        self, plates: Sequence[Plate], boxes: Sequence[Box], dictionary: str, optics: CameraOptics, seed: int
    ) -> None:
        self._optics = optics
        self._seed = seed
        self._quads = scene_quads(plates, boxes)
        self._bodies = int(self._quads.body.max(initial=-1)) + 1
        self._cells = _marker_cells(plates, dictionary)
        ray_x, ray_y = sample_rays(optics)
        self._view = view_of(ray_x, ray_y)
        self._ray_x, self._ray_y = ray_x.astype(np.float32), ray_y.astype(np.float32)
        self._falloff = _falloff(optics.size_px)
        # Buffers that every frame writes anew; fresh memory of their size would take a fifth of a frame's time.
        self._brush = np.zeros((*ray_x.shape, 3), np.uint16)
        self._still_depth, self._still_light = np.zeros_like(self._ray_x), np.zeros_like(self._brush)
        self._work_depth, self._work_light = np.zeros_like(self._ray_x), np.zeros_like(self._brush)
        height, width = self._falloff.shape[:2]
        self._work_pixels = np.zeros((height, width, 3), np.uint16)
        self._work_grey, self._noise = np.zeros((2, height, width, 3), np.float32)
        self._layer: _Layer | None = None
        self._last: dict[int, bytes] = {}

    def render(self, T_cam_body: FloatArray, frame_index: int) -> Image:
        """The frame (H, W, 3) uint8 BGR.

        Args:
            T_cam_body: (B, 4, 4) poses of the bodies in the camera (x right, y down, z forward), or (S, B, 4, 4) at S
                instants of the exposure, whose light is averaged; or, for a rolling shutter, (S, K, B, 4, 4) at S
                instants of the exposure of K rows, which are `k * height / (K - 1)`.
            frame_index: gives the noise, together with the seed: a frame is the same in whatever order it is rendered.

        Raises:
            InvalidData: for fewer bodies than the scene has, or poses that are no rigid motions.
        """
        instants = np.asarray(T_cam_body, dtype=np.float64)
        instants = instants[None] if instants.ndim == 3 else instants
        instants = instants[:, None] if instants.ndim == 4 else instants
        if instants.ndim != 5 or instants.shape[3:] != (4, 4) or not instants.shape[0] * instants.shape[1]:
            shapes = "(bodies, 4, 4), (instants, bodies, 4, 4) or (instants, rows, bodies, 4, 4)"
            raise InvalidData(f"poses have shape {np.shape(T_cam_body)}; want {shapes}")
        if instants.shape[2] < self._bodies:
            raise InvalidData(f"have poses of {instants.shape[2]} bodies; the scene has {self._bodies}")
        check_poses(instants, "T_cam_body")
        layer = self._still_layer(np.concatenate(list(instants)))
        moving = ~np.isin(self._quads.body, list(layer.poses))
        draws = [[self._draw_list(poses, moving) for poses in knots] for knots in instants]
        grey = self._with_moving(layer, [self._bands(knots) for knots in draws])
        return self._with_noise(grey, frame_index)

    def _draw_list(self, T_cam_body: FloatArray, wanted: NDArray[np.bool_]) -> _Draw:
        """All quads of an instant, of which those not `wanted` are not visible."""
        quads = self._quads
        T_cam_quad = T_cam_body[quads.body] @ quads.T_body_quad
        visible = wanted & facing(T_cam_quad)
        matrices = np.zeros((len(visible), 3, 3))
        matrices[visible] = ray_matrices(T_cam_quad[visible], quads.half_m[visible])
        rectangles = np.zeros((len(visible), 4), dtype=np.int64)
        rectangles[visible] = regions(T_cam_quad[visible], quads.half_m[visible], self._optics, self._view)
        visible &= np.all(rectangles[:, 2:] > rectangles[:, :2], axis=-1)
        towards = np.maximum(0.0, np.sum(T_cam_quad[:, :3, 2] * TO_LIGHT, axis=-1))
        light = quads.albedo_bgr * ((AMBIENT + DIRECT * towards) * self._optics.light)[:, None]
        return _Draw(visible, rectangles, T_cam_quad, matrices * quads.credit[:, None, None], light)

    def _bands(self, knots: Sequence[_Draw]) -> list[_Band]:
        """The parts of the image between the knots' rows."""
        height = self._optics.size_px[1]
        if len(knots) == 1:
            return [_Band((knots[0], knots[0]), 0, height, None)]
        rows_each = height / (len(knots) - 1)
        bands: list[_Band] = []
        for k, ends in enumerate(pairwise(knots)):
            top, bottom = int(np.ceil(k * rows_each)), int(np.ceil((k + 1) * rows_each))
            rows = np.repeat(np.arange(top, bottom), 2)[:, None]
            bands.append(_Band(ends, top, bottom, (rows / rows_each - k).astype(np.float32)))
        return bands

    def _still_layer(self, instants: FloatArray) -> _Layer:
        """The layer of the bodies that stand still, taken from the last frame where those are the same."""
        still = np.all(instants == instants[:1], axis=(0, 2, 3))
        poses = {body: instants[0, body].tobytes() for body in range(self._bodies) if still[body]}
        resting = {body: pose for body, pose in poses.items() if self._last.get(body, pose) == pose}
        self._last = {body: instants[-1, body].tobytes() for body in range(self._bodies)}
        layer = self._layer
        if layer is None or not (resting.keys() <= layer.poses.keys() and layer.poses.items() <= poses.items()):
            layer = self._layer = self._draw_layer(resting, instants[0])
        return layer

    def _draw_layer(self, poses: dict[int, bytes], T_cam_body: FloatArray) -> _Layer:
        depth, light = self._still_depth, self._still_light
        depth[...] = 0
        light[...] = self._wall_samples
        (band,) = self._bands([self._draw_list(T_cam_body, np.isin(self._quads.body, list(poses)))])
        for quad in np.flatnonzero(band.draws[0].visible):
            self._draw_quad(int(quad), band, depth, light)
        width, height = self._optics.size_px
        pixels = _pixels(light)
        return _Layer(poses, pixels, self._developed(pixels, (0, 0, width, height)))

    @cached_property
    def _wall_samples(self) -> Light:
        wall = np.clip(_wall(self._optics.size_px) * self._optics.light, 0, FULL).astype(np.uint16)
        return np.repeat(np.repeat(wall, 2, axis=0), 2, axis=1)

    def _with_moving(self, layer: _Layer, instants: Sequence[list[_Band]]) -> Singles:
        """Grey levels (H, W, 3) of the layer with the bodies that move drawn into it."""
        draws = [draw for bands in instants for band in bands for draw in band.draws]
        touched = np.concatenate([draw.regions[draw.visible] for draw in draws])
        if not len(touched):
            return layer.grey
        x0, y0, x1, y1 = area = _union(touched)
        total = np.zeros((y1 - y0, x1 - x0, 3), np.float32)
        for bands in instants:  # of one exposure: few
            cv2.accumulate(self._drawn(bands, area), total)
        pixels, grey = self._work_pixels, self._work_grey
        pixels[...] = layer.pixels
        grey[...] = layer.grey
        pixels[y0:y1, x0:x1] = np.rint(total / np.float32(len(instants)))
        reach = self._blur_reach
        width, height = self._optics.size_px
        changed = max(x0 - reach, 0), max(y0 - reach, 0), min(x1 + reach, width), min(y1 + reach, height)
        grey[changed[1] : changed[3], changed[0] : changed[2]] = self._developed(pixels, changed)
        return grey

    def _drawn(self, bands: Sequence[_Band], area: Rectangle) -> Light:
        """Light of the pixels in `area` at one instant."""
        x0, y0, x1, y1 = area
        samples = slice(2 * y0, 2 * y1), slice(2 * x0, 2 * x1)
        self._work_depth[samples] = self._still_depth[samples]
        self._work_light[samples] = self._still_light[samples]
        for band in bands:
            first, second = band.draws
            for quad in np.flatnonzero(first.visible & second.visible):
                self._draw_quad(int(quad), band, self._work_depth, self._work_light)
        return _pixels(self._work_light[samples])

    def _draw_quad(self, quad: int, band: _Band, depth: Singles, light: Light) -> None:
        first, second = band.draws
        x0, y0, x1, y1 = _union(np.stack([first.regions[quad], second.regions[quad]]))
        y0, y1 = max(y0, band.top), min(y1, band.bottom)
        if y0 >= y1:
            return
        samples = slice(2 * y0, 2 * y1), slice(2 * x0, 2 * x1)
        ray_x, ray_y = self._ray_x[samples], self._ray_y[samples]
        a, b, w = _plate_coordinates(first.matrices[quad], ray_x, ray_y)
        if band.share is not None:
            share = band.share[2 * (y0 - band.top) : 2 * (y1 - band.top)]
            change = _plate_coordinates(second.matrices[quad] - first.matrices[quad], ray_x, ray_y)
            for value, by in zip((a, b, w), change, strict=True):
                by *= share
                value += by
        # Shown where the plane is in front of the camera, |a| and |b| are below 1, and nothing nearer was drawn: as
        # a, b, w are all divided by the depth, that is w > |a|, |b| and the inverse depth there, which is 0 or more.
        bound = cv2.max(cv2.max(np.abs(a), np.abs(b)), depth[samples])
        shown = cv2.compare(w, bound, cv2.CMP_GT)
        plate = self._quads.plates[quad]
        colour = np.minimum(np.rint((first.light[quad] + second.light[quad]) / 2 * FULL), FULL)
        if plate is None:
            brush = self._brush[samples]
            cv2.rectangle(brush, (0, 0), (brush.shape[1], brush.shape[0]), colour.tolist(), cv2.FILLED)
        else:
            brush = self._printed(plate, first.T_cam_quad[quad], colour, (a, b, w))
        cv2.copyTo(brush, shown, light[samples])
        cv2.copyTo(w, shown, depth[samples])

    def _printed(
        self, plate: Plate, T_cam_marker: FloatArray, white: FloatArray, abw: tuple[Singles, Singles, Singles]
    ) -> Light:
        """Light of the plate's print at samples whose plate coordinates are a / w and b / w."""
        cells = self._cells[plate.marker_id]
        cell_m = plate.size_m / (len(cells) - 2)
        per_u, per_v = _texels(T_cam_marker, cell_m, self._optics)
        texture = np.rint(cells[..., None] * white).astype(np.uint16)
        texture = cv2.resize(texture, None, fx=per_u, fy=per_v, interpolation=cv2.INTER_NEAREST)
        half_cells = (plate.size_m / 2 + plate.margin_m) / cell_m
        middle = len(cells) / 2
        a, b, w = abw
        column = cv2.addWeighted(a, half_cells * per_u, w, middle * per_u - 0.5, 0)
        row = cv2.addWeighted(b, -half_cells * per_v, w, middle * per_v - 0.5, 0)
        paper = {"borderMode": cv2.BORDER_CONSTANT, "borderValue": white.tolist()}
        print_ = cv2.remap(texture, cv2.divide(column, w), cv2.divide(row, w), cv2.INTER_LINEAR, **paper)
        return np.asarray(print_, dtype=np.uint16)

    @property
    def _blur_reach(self) -> int:
        return int(np.ceil(BLUR_REACH * self._optics.blur_px))

    @cached_property
    def _tone(self) -> Singles:
        """Grey level of each value of light, (65536,)."""
        return (255 * (np.arange(FULL + 1) / FULL) ** (1 / self._optics.gamma)).astype(np.float32)

    def _developed(self, pixels: Light, area: Rectangle) -> Singles:
        """Grey levels of the pixels in `area`: falloff, blur and gamma."""
        reach = self._blur_reach
        x0, y0, x1, y1 = area
        left, top = max(x0 - reach, 0), max(y0 - reach, 0)
        around = slice(top, y1 + reach), slice(left, x1 + reach)
        lit = cv2.multiply(pixels[around], self._falloff[around], scale=1 / FULL)
        if reach:
            size = 2 * reach + 1
            lit = cv2.GaussianBlur(lit, (size, size), self._optics.blur_px, borderType=cv2.BORDER_REPLICATE)
        return np.asarray(cv2.LUT(lit[y0 - top : y1 - top, x0 - left : x1 - left], self._tone), dtype=np.float32)

    @cached_property
    def _gaussian(self) -> Singles:
        """65536 equally likely values of the noise: uniform 16-bit numbers become Gaussian by look-up."""
        return (self._optics.noise_grey * ndtri((np.arange(FULL + 1) + 0.5) / (FULL + 1))).astype(np.float32)

    def _with_noise(self, grey: Singles, frame_index: int) -> Image:
        if not self._optics.noise_grey:
            return np.asarray(cv2.convertScaleAbs(grey), dtype=np.uint8)
        bits = np.random.SFC64(np.random.SeedSequence((self._seed, frame_index)))
        random = bits.random_raw((grey.size + 3) // 4).view(np.uint16)[: grey.size]
        noise = cv2.LUT(random.reshape(grey.shape), self._gaussian, self._noise)
        return np.asarray(cv2.add(grey, noise, dtype=cv2.CV_8U), dtype=np.uint8)


def _plate_coordinates(matrix: FloatArray, ray_x: Singles, ray_y: Singles) -> tuple[Singles, Singles, Singles]:
    """What the matrix (3, 3) of a quad makes of rays (x, y, 1), row by row."""
    a, b, w = (
        np.asarray(cv2.addWeighted(ray_x, m_x, ray_y, m_y, m_1), dtype=np.float32) for m_x, m_y, m_1 in matrix.tolist()
    )
    return a, b, w


def _marker_cells(plates: Sequence[Plate], dictionary: str) -> dict[int, Singles]:
    """What each marker's cells reflect (n + 2, n + 2): 1 for white, INK for black, with a ring of white around."""
    code = getattr(cv2.aruco, dictionary, None) if dictionary.startswith("DICT_") else None
    if code is None:
        names = sorted(name for name in dir(cv2.aruco) if name.startswith("DICT_"))
        raise InvalidData(f"there is no marker dictionary '{dictionary}'; have {', '.join(names)}")
    book = cv2.aruco.getPredefinedDictionary(code)
    cells: dict[int, Singles] = {}
    for plate in plates:
        if not 0 <= plate.marker_id < len(book.bytesList):
            raise InvalidData(f"{dictionary} has markers 0 to {len(book.bytesList) - 1}; have marker {plate.marker_id}")
        bits = book.generateImageMarker(plate.marker_id, book.markerSize + 2)
        cells[plate.marker_id] = np.pad(np.where(bits > 0, 1.0, INK), 1, constant_values=1.0).astype(np.float32)
    return cells


def _texels(T_cam_marker: FloatArray, cell_m: float, optics: CameraOptics) -> tuple[int, int]:
    """Texels per cell across and down, such that an edge's ramp is 1 / TEXELS_PER_PX wide across the edge."""
    x, y, z = T_cam_marker[:3, 3]
    f = np.sqrt(optics.matrix[0, 0] * optics.matrix[1, 1])
    depth = max(z, 1e-3)
    along = f / depth * (T_cam_marker[:2, :2] - np.outer((x / depth, y / depth), T_cam_marker[2, :2]))
    area = abs(along[0, 0] * along[1, 1] - along[0, 1] * along[1, 0])
    across = area / np.maximum(np.linalg.norm(along[:, ::-1], axis=0), 1e-9)
    per = np.clip(np.rint(TEXELS_PER_PX * cell_m * across), 1, MAX_TEXELS)
    return int(per[0]), int(per[1])
