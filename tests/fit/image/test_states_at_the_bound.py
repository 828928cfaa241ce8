"""Trees from corners are as good as they can be: held against the Cramer-Rao bound, computed by other code.

A bound is of the mean over many noises. The best linear estimate of the very noise scatters as the fit does, so that
the two can be compared to a few per cent in one run.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from station.fit.options import FitOptions
from tests.fit.image.held_fits import HeldFit, fitted, held
from tests.fit.image.simulated_views import Scene, Seeing, watched

ARM = Scene(joints=3, kinds=("revolute", "prismatic", "screw"), frames=120, tilt_deg=(10.0, 70.0))
CASES = {
    "static root": (1, ARM, Seeing(sigma_px=0.05)),
    "moving root": (2, replace(ARM, root_moves=True, course="steps"), Seeing(sigma_px=0.1)),
    "correlated noise, edges off": (3, ARM, Seeing(sigma_px=0.1, correlated=True, edge_shift_px=-0.3)),
    "two markers on some bodies": (4, replace(ARM, trackers=(1, 2), markers=(1, 2)), Seeing(sigma_px=0.1)),
    "noise told as half": (5, ARM, Seeing(sigma_px=0.1, stated=0.5)),
}


def of_corners(seed: int, scene: Scene, seeing: Seeing) -> HeldFit:
    found = watched(seed, scene, seeing)
    options = FitOptions(joint_types=("rigid", "prismatic", "revolute", "screw"), root=found.tree.root)
    fit = held(found, fitted(found, options))
    assert not fit.mistakes
    return fit


@cache
def of_case(case: str) -> HeldFit:
    return of_corners(*CASES[case])


@pytest.mark.parametrize("case", CASES)
def test_states_err_no_more_than_the_best_linear_estimate(case: str) -> None:
    for joint in of_case(case).joints:
        assert joint.share_found == 1.0
        # The fit weighs markers by the noise that they turn out to have, good to some per cent; the rest is curvature.
        assert joint.ratio == pytest.approx(joint.chance, rel=0.03)


@pytest.mark.parametrize("case", CASES)
def test_what_is_stated_of_states_and_geometry_is_the_bound(case: str) -> None:
    for joint in of_case(case).joints:
        # The noise is known from 4 to 7 markers of 120 frames, to 2 to 3 %.
        assert joint.state_size == pytest.approx(1.0, abs=0.1)
        for _, size in (joint.axis_inside, joint.point_inside):
            assert np.isnan(size) or size == pytest.approx(1.0, abs=0.1)


def test_missing_and_wrong_sightings_cost_no_more_than_what_they_would_have_told() -> None:
    scene = replace(ARM, frames=200)
    fit = of_corners(6, scene, Seeing(sigma_px=0.1, missing=0.1, outliers=0.03))
    assert not (fit.wrong & ~fit.told).any()
    for joint in fit.joints:
        assert joint.share_found > 0.97
        assert joint.ratio < 1.1 * joint.chance


def test_a_rolling_shutter_that_is_known_costs_little() -> None:
    whole, by_rows = (of_corners(7, ARM, Seeing(sigma_px=0.1, readout_s=readout_s)) for readout_s in (0.0, 0.025))
    for at_once, in_rows in zip(whole.joints, by_rows.joints, strict=True):
        assert in_rows.state_rms < 1.3 * at_once.state_rms
