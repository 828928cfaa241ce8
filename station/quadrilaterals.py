"""Edges of quadrilaterals in an image: directions, normals, intersections, and quadrilaterals with shifted edges."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from station.logs import FloatArray


class Edges(NamedTuple):
    """The edges of M quadrilaterals, edge i from corner i to i + 1.

    The corners run clockwise as seen (y down); seen from behind, which no marker is, the normals would point inward.

    Attributes:
        direction: (M, 4, 2) unit vectors.
        normal: (M, 4, 2) outward unit vectors.
        length_px: (M, 4).
        middle_px: (M, 4, 2).
    """

    direction: FloatArray
    normal: FloatArray
    length_px: FloatArray
    middle_px: FloatArray


def following(values: FloatArray) -> FloatArray:
    """Values (M, 4, ...) of the next corner or edge around."""
    return values[:, [1, 2, 3, 0]]


def preceding(values: FloatArray) -> FloatArray:
    """Values (M, 4, ...) of the corner or edge before."""
    return values[:, [3, 0, 1, 2]]


def edges_of(corners_px: FloatArray) -> Edges:
    """The edges of quadrilaterals with corners (M, 4, 2) px."""
    after = following(corners_px)
    along = after - corners_px
    length_px = np.sqrt(np.einsum("mek,mek->me", along, along))
    direction = along / length_px[..., None]
    normal = direction[..., ::-1] * (1.0, -1.0)
    return Edges(direction, normal, length_px, 0.5 * (corners_px + after))


def intersect_edges(normal: FloatArray, offset_px: FloatArray) -> FloatArray:
    """Corners (M, 4, 2): corner i is where edges i - 1 and i meet.

    Edge i is the line `normal . p = offset`, with normals (M, 4, 2) of any length and offsets (M, 4).
    """
    before_n, before_c = preceding(normal), preceding(offset_px)
    det = before_n[..., 0] * normal[..., 1] - before_n[..., 1] * normal[..., 0]
    x = before_c * normal[..., 1] - offset_px * before_n[..., 1]
    y = before_n[..., 0] * offset_px - normal[..., 0] * before_c
    return np.stack([x, y], axis=-1) / np.where(det == 0, np.nan, det)[..., None]


def shift_edges(corners_px: FloatArray, outward_px: float) -> FloatArray:
    """Corners (M, 4, 2) of the quadrilaterals whose edges are moved along their outward normals by `outward_px`."""
    normal = edges_of(corners_px).normal
    return intersect_edges(normal, np.sum(normal * corners_px, axis=-1) + outward_px)


def edge_shift_jacobian(corners_px: FloatArray) -> FloatArray:
    """Motions (M, 4, 2) of the corners per px by which all edges move outward: the signature of a shared edge shift."""
    normal = edges_of(corners_px).normal
    return intersect_edges(normal, np.ones(normal.shape[:-1]))
