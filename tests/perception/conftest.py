"""Rendered markers, as fixtures for the tests of perception."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import pytest

from calibration.intrinsics import CameraModel, FloatArray
from tests import rendered_markers

Render = Callable[..., np.ndarray]


@pytest.fixture(scope="session")
def camera() -> CameraModel:
    """640x480, f = 600 px, a webcam's distortion."""
    return rendered_markers.webcam()


@pytest.fixture(scope="session")
def render() -> Render:
    """render(ids, T_cam_marker (M, 4, 4), size_m, camera, rng, ...) -> grey image (H, W) uint8."""

    def render_image(
        ids: Sequence[int],
        T_cam_marker: FloatArray,
        size_m: float,
        camera: CameraModel,
        rng: np.random.Generator,
        *,
        rays: int = 6,
        **developing: float,
    ) -> np.ndarray:
        light = rendered_markers.scene_light(ids, T_cam_marker, size_m, camera, rays=rays)
        return rendered_markers.developed(light, rng, **developing)

    return render_image


@pytest.fixture(scope="session")
def pose_facing() -> Callable[..., FloatArray]:
    """facing(tilt_rad, azimuth_rad, spin_rad, t_m) -> T_cam_marker."""
    return rendered_markers.facing


@pytest.fixture(scope="session")
def project_corners() -> Callable[..., FloatArray]:
    """true_corners(T_cam_marker, size_m, camera) -> (4, 2) px by cv2.projectPoints."""
    return rendered_markers.true_corners
