"""Closed forms: circles and spheres without bias on short arcs, axes by turns."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from station.kinematics.joints.closed_forms import axis_by_turns, round_fit, turns_about_z


def arc(rng: np.random.Generator, dimensions: int, *, radius: float, reach: float, count: int) -> np.ndarray:
    """(count, d) points of a circle or sphere about (1, 2, ...), no farther from one of them than this angle."""
    angle = reach * np.sqrt(rng.uniform(size=count)) * (1 if dimensions == 3 else rng.choice([-1, 1], count))
    around = rng.uniform(0, 2 * np.pi, count) if dimensions == 3 else np.zeros(count)
    p = np.stack([np.cos(angle), np.sin(angle) * np.cos(around), np.sin(angle) * np.sin(around)], axis=-1)
    return np.arange(1, dimensions + 1) + radius * p[:, :dimensions]


@pytest.mark.parametrize("dimensions", [2, 3])
@pytest.mark.parametrize("reach", [0.3, 3.0])
def test_exact_points_give_the_circle_or_sphere(dimensions: int, reach: float) -> None:
    p = arc(np.random.default_rng(0), dimensions, radius=0.3, reach=reach, count=50)
    centre, radius = round_fit(p, np.ones(50))
    np.testing.assert_allclose(centre, np.arange(1, dimensions + 1), atol=1e-5)  # m: its own regularisation
    assert radius == pytest.approx(0.3, abs=1e-5)


@pytest.mark.parametrize("dimensions", [2, 3])
def test_short_noisy_arcs_keep_their_radius(dimensions: int) -> None:
    rng = np.random.default_rng(1)
    exact = arc(rng, dimensions, radius=0.3, reach=0.5, count=200)
    p = exact + 0.005 * rng.normal(size=(2000, 200, dimensions))
    _, radius = round_fit(p, np.ones((2000, 200)))
    assert abs(np.mean(radius) - 0.3) < 0.001  # m: four deviations of the mean; a biased sphere is 4 mm larger
    assert np.std(radius) < 0.012


def test_the_fit_is_as_good_as_that_of_least_distances() -> None:
    rng = np.random.default_rng(2)
    exact = arc(rng, 3, radius=0.3, reach=0.8, count=100)
    errors = []
    for _ in range(40):
        p = exact + 0.003 * rng.normal(size=(100, 3))

        def distances(x: np.ndarray, p: np.ndarray = p) -> np.ndarray:
            return np.linalg.norm(p - x[:-1], axis=-1) - x[-1]

        _, radius = round_fit(p, np.ones(100))
        errors.append((radius - 0.3, least_squares(distances, [1, 2, 3, 0.3]).x[-1] - 0.3))
    ours, best = np.sqrt(np.mean(np.square(errors), axis=0))
    assert ours < 1.05 * best


def test_points_of_no_weight_are_ignored() -> None:
    rng = np.random.default_rng(2)
    p = arc(rng, 3, radius=0.3, reach=1.0, count=50)
    spoilt = p.copy()
    spoilt[::5] += rng.normal(size=(10, 3))
    centre, radius = round_fit(spoilt, (np.arange(50) % 5 > 0).astype(float))
    np.testing.assert_allclose(centre, [1, 2, 3], atol=1e-5)
    assert radius == pytest.approx(0.3, abs=1e-5)


@pytest.mark.parametrize("travel", [1e-3, 1.0, 50.0])
def test_rotations_tell_the_axis_and_the_turns(travel: float) -> None:
    rng = np.random.default_rng(3)
    axis, q = Rotation.random(random_state=rng).as_matrix()[:, 2], np.linspace(0, travel, 40)
    R = (Rotation.from_rotvec(q[:, None] * axis) * Rotation.random(random_state=rng)).as_matrix()
    R_axis_parent, R_axis_child, turns = axis_by_turns(R, np.ones(40))
    along = R_axis_parent[2] @ axis
    assert abs(along) == pytest.approx(1, abs=1e-6)
    np.testing.assert_allclose(np.exp(1j * (turns - turns[0])), np.exp(1j * np.sign(along) * q), atol=1e-8)
    np.testing.assert_allclose(turns_about_z(R_axis_parent @ R, R_axis_child), turns, atol=1e-12)
