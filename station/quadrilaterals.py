"""Edges of quadrilaterals in an image: directions, normals, intersections, and quadrilaterals with shifted edges."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from station.logs import FloatArray

# Of a marker's side: its black border is one cell wide. That of 4x4 bits has six; of markers with more it is narrower.
BORDER_SHARE = 1 / 6
# Width of the border [px] at which its edges show half of the shift, and how fast that changes (a logistic curve's).
NARROW_PX, NARROW_SPREAD_PX = 3.2, 0.75
# Each makes the error some 0.03 times as large.
UNSHIFT_ROUNDS = 5


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


def edge_shift_shares(corners_px: FloatArray) -> FloatArray:
    """(M, 4) how much of a camera's edge shift each edge of markers with corners (M, 4, 2) px shows: 0 to 1.

    The shift is of black that is wide. Where a marker's border is narrow, as a tilted one's is, blur reaches across it,
    and less is seen: half at NARROW_PX. Measured on rendered pictures (blur 0.5 to 0.9 px, gamma 2.0 to 2.4), as means:
    0.2 at 2 px, 0.45 at 3.2, 0.75 at 4, 0.95 at 5.5. Not measured on a real camera.
    """
    normal = edges_of(corners_px).normal
    far = corners_px[:, [2, 3, 0, 1]] + preceding(corners_px)  # twice the middle of the opposite edge
    border_px = BORDER_SHARE * np.sum(normal * (corners_px - far / 2), axis=-1)
    # Of a logistic curve, as a tangent: it doesn't overflow.
    return 0.5 + 0.5 * np.tanh((border_px - NARROW_PX) / (2 * NARROW_SPREAD_PX))


def shift_edges(corners_px: FloatArray, outward_px: float) -> FloatArray:
    """Corners (M, 4, 2) as a camera sees them that shows dark edges so far outward, each by its share."""
    return _moved_out(corners_px, outward_px * edge_shift_shares(corners_px))


def unshift_edges(seen_px: FloatArray, outward_px: float) -> FloatArray:
    """Corners (M, 4, 2) that a camera of this edge shift shows at `seen_px` (M, 4, 2): undoes `shift_edges`."""
    found = seen_px
    for _ in range(UNSHIFT_ROUNDS):  # an edge's share goes with where the corners are
        found = _moved_out(seen_px, -outward_px * edge_shift_shares(found))
    return found


def edge_shift_jacobian(corners_px: FloatArray) -> FloatArray:
    """Motions (M, 4, 2) of the corners per px of a shared edge shift: its signature."""
    return intersect_edges(edges_of(corners_px).normal, edge_shift_shares(corners_px))


def _moved_out(corners_px: FloatArray, outward_px: FloatArray) -> FloatArray:
    """Corners (M, 4, 2) of the quadrilaterals whose edges are moved along their outward normals by (M, 4)."""
    normal = edges_of(corners_px).normal
    return intersect_edges(normal, np.sum(normal * corners_px, axis=-1) + outward_px)
