"""The promise of the demo: the arm's structure and its angles, from pictures alone; the other packaged rig as well."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from station.commands import reporting, sessions
from station.fit_files import read_fit
from station.recording import Recording
from tests.benchmarks.demo_seeds import JOINTS, rmse_deg, structure_right
from tests.sessions import slower_rig


@pytest.fixture(scope="module")
def demo(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("demo") / "demo"
    sessions.run("demo", "demo", out, seed=0)
    return out


def test_the_demo_finds_the_arm(demo: Path):
    assert structure_right(read_fit(demo / "fit").tree)


def test_detected_angles_agree_with_the_read_back(demo: Path):
    """Half a degree for the base and one for the others is promised; a servo's count alone is 0.085 deg RMS."""
    rmse = rmse_deg(reporting.compare(demo))
    assert set(rmse) == set(JOINTS)
    assert rmse["base_pan"] <= 0.5 and max(rmse.values()) <= 1.0


def test_the_base_turns_to_80_degrees_and_is_seen_there(demo: Path):
    pan = np.degrees(Recording.load(demo).measured.state("base_pan"))
    assert pan.max() > 79 and pan.min() < -79
    states = read_fit(demo / "fit").states
    assert np.ptp(np.degrees(states.state("base_pan")[np.isfinite(states.state("base_pan"))])) > 155


def test_the_second_packaged_rig_works_over_protocol_2(tmp_path: Path):
    """Four XM430 on protocol 2.0, streamed commands; at its camera's own speed in the benchmark packaged_rigs."""
    comparison = sessions.run(slower_rig("openmanipulator_x", tmp_path), "openmanipulator_x", tmp_path / "x")
    rmse = rmse_deg(comparison)
    assert set(rmse) == {"joint1", "joint2", "joint3", "joint4"} and max(rmse.values()) <= 1.0
    assert {joint.type for joint in comparison.joints} == {"revolute"}
    assert not comparison.unmatched_fitted
