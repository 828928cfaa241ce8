"""Noise as a camera makes it when it measures the pose of a planar square, such as a marker, from its corners.

It answers the question that the paper leaves open (IV-C: that noise is uniform in se(3) is a naive assumption
perhaps, "so future work should vary this distribution"). Corners that err by so many pixels put the marker off across
the line of sight by as much as a pixel is at its distance; along it, by the error of its size in the image: worse by
the distance over its size, and growing with the square of the distance. Turns about the line of sight are seen as
they are, tilts only by the foreshortening. And a square has two poses that look nearly the same, one tilted as much
as the other but the other way: now and then the wrong one is told.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import ndtri

from station.errors import InvalidData
from station.kinematics import se3
from station.logs import FloatArray
from station.simulate.noise import Noise, check_magnitude, check_share

Z = np.array([0.0, 0.0, 1.0])
# A part this near the camera's centre [m] has no line of sight: it counts as one on the optical axis.
NO_SIGHT_M = 1e-9


@dataclass(frozen=True)
class CameraNoise(Noise):
    """Normal, in directions of the line of sight, and with the flips of a planar square.

    The camera looks along the world's z; the object's middle over all frames is `distance_m` before it. The magnitudes
    are the standard deviations at that distance, across the line of sight and about it. They grow with the distance,
    the depth's with its square. Whether a part faces the camera is not asked.

    Attributes:
        distance_m: of the object's middle.
        depth_ratio: standard deviation along the line of sight over that across it.
        tilt_ratio: of turns about axes across the line of sight over that about it.
        flips: share of poses whose tilt is the other one of the two that a square allows.

    Raises:
        InvalidData: for magnitudes, a distance, ratios or a share that are none.
    """

    name = "camera"
    reference = "camera"
    distance_m: float = 1.0
    depth_ratio: float = 5.0
    tilt_ratio: float = 3.0
    flips: float = 0.02

    def __post_init__(self) -> None:
        Noise.__post_init__(self)
        check_magnitude(self.distance_m, "distance of the camera", "m")
        if not self.distance_m > 0:
            raise InvalidData("distance of the camera is 0 m; want more")
        check_magnitude(self.depth_ratio, "ratio of depth", "1")
        check_magnitude(self.tilt_ratio, "ratio of tilt", "1")
        check_share(self.flips, "flips")

    @property
    def variance(self) -> float:
        return 1.0

    def draws(self, rng: np.random.Generator, shape: tuple[int, ...]) -> FloatArray:
        """(*shape, 7): six of the noise, one that decides whether the pose is flipped."""
        return rng.standard_normal((*shape, 7))

    def viewed(self, T_world_part: FloatArray) -> FloatArray:
        """(..., T, K, 4, 4) poses in a camera with the world's directions."""
        p_world = T_world_part[..., :3, 3]
        T_camera_world = se3.translation(self.distance_m * Z - p_world.mean(axis=(-3, -2)))
        return T_camera_world[..., None, None, :, :] @ T_world_part

    def apply(self, T_ref_part: FloatArray, draws: FloatArray, *, planar: bool = False) -> FloatArray:
        """(..., 4, 4) poses, some flipped, with noise; raises InvalidData for planar objects."""
        if planar:
            raise InvalidData("camera noise is in space; choose another model, or leave planar_noise out")
        flipped = (draws[..., 6] < ndtri(self.flips))[..., None, None]
        T = np.where(flipped, flipped_square(T_ref_part), T_ref_part)
        R_part_sight, std = self._directions(T)
        v, w = np.split(draws[..., :6] * std, 2, axis=-1)
        xi = np.concatenate([R_part_sight @ v[..., None], R_part_sight @ w[..., None]], axis=-2)[..., 0]
        return T @ se3.exp(xi)

    def covariance(self, T_ref_part: FloatArray) -> FloatArray:
        """(..., 6, 6) of the noise without flips."""
        R, std = self._directions(T_ref_part)
        found = np.zeros((*std.shape, 6))
        for half in (slice(0, 3), slice(3, 6)):
            found[..., half, half] = (R * std[..., None, half] ** 2) @ np.swapaxes(R, -1, -2)
        return found

    def _directions(self, T: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(..., 3, 3) axes of the line of sight, which is z, in the part; (..., 6) standard deviations there."""
        R_sight_part = np.swapaxes(se3.rotation_between(Z, _sight(T)), -1, -2) @ T[..., :3, :3]
        farther = np.linalg.norm(T[..., :3, 3], axis=-1)[..., None] / self.distance_m
        across = farther * [1.0, 1.0, self.depth_ratio] * np.where([False, False, True], farther, 1.0)
        turn = farther * [self.tilt_ratio, self.tilt_ratio, 1.0]
        std = np.concatenate([self.translation_m * across, self.rotation_rad * turn], axis=-1)
        return np.swapaxes(R_sight_part, -1, -2), std


def flipped_square(T_camera_part: FloatArray) -> FloatArray:
    """(..., 4, 4) the other pose of a planar square, whose z is its normal, that looks the same from far away.

    From far away an image shows of its edges x and y what is across the line of sight r; what is along r may as well
    have the other sign. With the reflection H = 1 - 2 r r^T the edges are H x and H y, and z is x cross y.
    """
    r = _sight(T_camera_part)
    H = np.eye(3) - 2 * r[..., :, None] * r[..., None, :]
    return se3.pose(H @ T_camera_part[..., :3, :3] @ np.diag([1.0, 1.0, -1.0]), T_camera_part[..., :3, 3])


def _sight(T: FloatArray) -> FloatArray:
    """(..., 3) unit vectors from the camera to parts."""
    p = T[..., :3, 3]
    length = np.linalg.norm(p, axis=-1, keepdims=True)
    return np.where(length > NO_SIGHT_M, p / np.where(length > NO_SIGHT_M, length, 1.0), Z)
