"""The shift that black squares' edges share: what it is, and how well it is known."""

import numpy as np
import pytest

from calibration.edge_shift import FLOOR_PX, estimate_edge_shift
from calibration.errors import CalibrationError

SQUARE_PX = np.array([[0.0, 0], [40, 0], [40, 40], [0, 40]])
OUTWARD = np.array([[-1.0, -1], [1, -1], [1, 1], [-1, 1]])


def seen_views(shifts_px: np.ndarray, markers: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Seen and true corners of markers whose edges lie outward by their view's shift, and their views."""
    view = np.repeat(np.arange(len(shifts_px)), markers)
    true = SQUARE_PX + 60.0 * np.arange(len(view))[:, None, None]
    return true + shifts_px[view][:, None, None] * OUTWARD, true, view


def test_a_square_that_looks_larger_has_a_positive_shift() -> None:
    found = estimate_edge_shift(*seen_views(np.full(6, 0.2), 5))
    assert found.shift_px == pytest.approx(0.2) and found.markers == 30


def test_views_that_disagree_make_the_shift_uncertain() -> None:
    shifts_px = 0.1 + 0.05 * np.random.default_rng(0).standard_normal(12)
    found = estimate_edge_shift(*seen_views(shifts_px, 5))
    assert found.std_px == pytest.approx(np.hypot(shifts_px.std(ddof=1) / 12**0.5, FLOOR_PX), rel=1e-6)


def test_few_markers_tell_no_shift() -> None:
    with pytest.raises(CalibrationError, match="tell no edge shift"):
        estimate_edge_shift(*seen_views(np.full(1, 0.2), 1))
