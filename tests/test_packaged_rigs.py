"""Packaged rigs: each is read, plans its own motion, and finds joints that it moves. Whole runs are a benchmark
(packaged_rigs), those of the demo and of the OpenMANIPULATOR-X in test_demo."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from station.commands import capturing, fitting, planning, reporting
from station.compare import Comparison
from station.motion import Plan
from station.rig import load_rig
from station.rig_reading import packaged_names
from tests.benchmarks.demo_seeds import rmse_deg
from tests.sessions import slower_rig

NAMES = packaged_names("rigs")
RUN_WHOLE_ELSEWHERE = ("demo", "openmanipulator_x")


def test_every_rig_has_a_motion_of_its_name():
    assert set(NAMES) <= set(packaged_names("motions"))


@pytest.mark.parametrize("name", NAMES)
def test_a_packaged_motion_moves_each_joint_alone_and_ends_where_it_began(name: str):
    planned = planning.plan(name, name)
    moved = [np.flatnonzero(leg.q_from != leg.q_to) for leg in planned.segments]
    alone = {planned.joints[joints[0]].name for joints in moved if len(joints) == 1}
    ever = {planned.joints[j].name for joints in moved for j in joints}
    assert alone == ever >= {joint.name for joint in planned.joints} - {"gripper"}
    assert any(len(joints) == len(ever) for joints in moved), "all together at the end"
    np.testing.assert_allclose(planned.segments[-1].q_to, planned.park, atol=1e-12)
    assert planned.duration_s <= 45


@pytest.mark.parametrize("name", NAMES)
def test_every_seen_body_of_a_packaged_rig_has_two_markers(name: str):
    simulation = load_rig(name).table.simulation
    assert simulation is not None
    bodies = [plate.body for plate in simulation.plate]
    assert {bodies.count(body) for body in bodies} == {2}


def two_joints(name: str, planned: Plan) -> dict[str, float]:
    """Two joints and the first targets [deg] to which the motion moves them alone: the last one, and before it the
    first one that several servos turn, or the very first."""
    targets: dict[str, float] = {}
    for leg in planned.segments:
        moved = np.flatnonzero(leg.q_from != leg.q_to)
        if len(moved) == 1:
            targets.setdefault(planned.joints[moved[0]].name, float(np.degrees(leg.q_to[moved[0]])))
    ganged = [joint.name for joint in load_rig(name).table.joint if len(joint.servo) > 1]
    first, last = (ganged or list(targets))[0], list(targets)[-1]
    return {joint: targets[joint] for joint in (first, last)}


def piece(name: str, folder: Path) -> tuple[str, Path, set[str]]:
    """The rig with a slower camera, and a motion of two of its joints, one after the other."""
    planned = planning.plan(name, name)
    parked = {joint.name: float(np.degrees(joint.park)) for joint in planned.joints}
    moves = [(joint, to) for joint, there in two_joints(name, planned).items() for to in (there, parked[joint])]
    steps = "".join(f"[[step]]\nmove = {{ {j} = {to:.3f} }}\nspeed_deg_s = 40\nhold_s = 0.2\n" for j, to in moves)
    text = f'schema = "motion/1"\nname = "piece"\nmode = "{planned.motion.mode}"\n{steps}'
    (folder / "motion.toml").write_text(text, encoding="utf-8")
    return slower_rig(name, folder, fps=15), folder / "motion.toml", {joint for joint, _ in moves}


@pytest.fixture(scope="module", params=[name for name in NAMES if name not in RUN_WHOLE_ELSEWHERE])
def compared(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[Comparison, set[str]]:
    """A piece of a rig's motion, captured, fitted and compared; and the joints that it moves."""
    folder = tmp_path_factory.mktemp(request.param)
    rig, motion, moved = piece(request.param, folder)
    out = folder / "session"
    capturing.capture(rig, str(motion), out)
    fitting.fit(out)
    return reporting.compare(out), moved


def test_a_packaged_rig_finds_the_joints_that_a_piece_of_its_motion_moves(compared: tuple[Comparison, set[str]]):
    comparison, moved = compared
    rmse = rmse_deg(comparison)
    assert set(rmse) == moved and max(rmse.values()) <= 0.5
    assert {joint.type for joint in comparison.joints} == {"revolute"}
    assert not comparison.unmatched_fitted and not comparison.unmatched_commanded
    assert "gripper" in comparison.at_rest
