"""`station calibrate scale`: the emulated arm's axes and its gripper's travel tell whether lengths are right."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from station.calibrating.known_lengths import axis_distances, prismatic_travels
from station.commands import capturing, fitting
from station.compare import compare
from station.fit_files import read_fit
from station.logs import JointLog
from tests.sessions import write_motion

BOTH = """
schema = "motion/1"
name = "both"
[[step]]
move = { elbow = -40 }
speed_deg_s = 50
hold_s = 0.2
[[step]]
move = { shoulder = 35 }
speed_deg_s = 50
hold_s = 0.2
[[step]]
move = { elbow = 0, shoulder = -20 }
speed_deg_s = 50
hold_s = 0.2
[[step]]
move = { base_pan = 30 }
speed_deg_s = 50
hold_s = 0.2
"""


@pytest.fixture(scope="module")
def fitted(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    folder = tmp_path_factory.mktemp("scale")
    out = folder / "session"
    capturing.capture("demo", write_motion(folder, BOTH), out)
    fitting.fit(out)
    yield out


def test_the_distance_of_shoulder_and_elbow_tells_the_markers_scale(station, fitted: Path):
    code, out, err = station("calibrate", "scale", fitted, "--axis-distance", "shoulder,elbow=140", "--json")
    assert code == 0, err
    found = json.loads(out)
    # 140 mm in the simulation; rendered corners are good for a tenth of a percent.
    assert found["ratio"] == pytest.approx(1.0, abs=2e-3) and 0 < found["std"] < 2e-3 and not found["off"]
    code, out, err = station("calibrate", "scale", fitted, "--axis-distance", "elbow,shoulder=137.2")
    assert code == 1 and "size_mm seems too large, by a factor of 1.02" in out
    # pan and shoulder cross at right angles: no distance, but the order and the body don't matter
    tree = read_fit(fitted / "fit").tree
    (pan,) = axis_distances(tree, {("shoulder", "base_pan"): 0.001})
    assert pan.ratio < 5


def test_bad_input_to_the_scale_is_one_clear_error(station, fitted: Path, tmp_path: Path):
    cases = [
        ((fitted,), "no length is known"),
        ((fitted, "--axis-distance", "shoulder,knee=140"), "no joint 'knee' was fitted"),
        ((fitted, "--axis-distance", "base_pan,elbow=140"), "aren't joints of one body"),
        ((fitted, "--axis-distance", "shoulder,elbow"), "want two joints and mm"),
        ((fitted, "--axis-distance", "shoulder,elbow=-3"), "want more than 0"),
        ((tmp_path / "gone",), "missing"),
    ]
    for arguments, said in cases:
        code, _, err = station("calibrate", "scale", *arguments)
        assert code == 1 and said in err and len(err.splitlines()) <= 5 and "Traceback" not in err, (arguments, err)


def test_a_prismatic_joints_gain_against_its_read_back_is_a_length():
    t_s = np.arange(0, 10, 1 / 30)
    travel_m = 0.015 * np.sin(t_s)
    noise = np.random.default_rng(1).normal(0, 1e-4, len(t_s))
    detected = JointLog(t_s, ("slide",), (1.02 * travel_m + noise)[:, None], ("m",))
    measured = JointLog(t_s, ("gripper",), travel_m[:, None], ("m",))
    (length,) = prismatic_travels(compare(detected, None, measured))
    assert length.ratio == pytest.approx(1.02, abs=4 * length.std) and 1e-4 < length.std < 2e-3
    assert "gripper" in length.what
    turning = JointLog(t_s, ("hinge",), travel_m[:, None], ("rad",))
    assert not list(prismatic_travels(compare(turning, None, JointLog(t_s, ("pan",), travel_m[:, None], ("rad",)))))
