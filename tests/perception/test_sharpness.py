"""Widths of markers' edges: what a blur of known size makes them."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from station.perception.sharpness import edge_widths_px

CORNERS = np.array([[[40.0, 40], [120, 40], [120, 120], [40, 120]]])
CELLS = 6


def square(sigma_px: tuple[float, float], *, colour: bool = False) -> np.ndarray:
    """A black square on white, blurred by a Gaussian of these sigmas along x and y."""
    image = np.full((160, 160), 230, np.uint8)
    image[40:121, 40:121] = 20
    image = np.asarray(cv2.GaussianBlur(image, (0, 0), sigmaX=sigma_px[0], sigmaY=sigma_px[1]))
    return np.repeat(image[..., None], 3, axis=2) if colour else image


@pytest.mark.parametrize("sigma_px", [1.0, 1.5, 2.0, 3.0])
@pytest.mark.parametrize("colour", [False, True])
def test_a_gaussian_blur_is_as_wide_as_its_steepest_slope_says(sigma_px: float, colour: bool) -> None:
    width_px = edge_widths_px(square((sigma_px, sigma_px), colour=colour), CORNERS, CELLS)
    # contrast over slope of a Gaussian step; one sample every 0.67 px flattens the peak
    np.testing.assert_allclose(width_px, np.sqrt(2 * np.pi) * sigma_px, rtol=0.06)


def test_a_smear_along_x_widens_the_upright_edges_alone() -> None:
    (width_px,) = edge_widths_px(square((3.0, 0.5)), CORNERS, CELLS)
    assert np.all(width_px[[1, 3]] > 6.5) and np.all(width_px[[0, 2]] < 2.5)


def test_without_contrast_or_markers_there_is_no_width() -> None:
    assert np.all(np.isnan(edge_widths_px(np.full((160, 160), 99, np.uint8), CORNERS, CELLS)))
    assert edge_widths_px(square((1.0, 1.0)), np.zeros((0, 4, 2)), CELLS).shape == (0, 4)


def test_a_corner_outside_of_the_image_is_no_error() -> None:
    assert edge_widths_px(square((1.0, 1.0)), CORNERS - 60, CELLS).shape == (1, 4)
