"""The demo against the truth: detected angles against the emulated shafts', axes against the drawn ones.

Run: python -m tests.benchmarks.demo_truth [SEED]
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path
from unittest import mock

import numpy as np

from station.commands import fitting, sessions
from station.emulated_arm import EmulatedArm
from station.fit_files import read_fit
from station.kinematics import se3
from station.rig import load_rig
from station.stage import Stage
from tests.benchmarks.demo_seeds import BODIES, JOINTS


def capture_with_truth(out: Path, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Run the demo into `out`; times [s] and true angles (F, 4) [rad] at which its frames were rendered."""
    asked: dict[int, np.ndarray] = {}
    true_angles = EmulatedArm.joint_states

    def joint_states(self: EmulatedArm, t_ns: int) -> np.ndarray:
        asked[t_ns] = true_angles(self, t_ns)
        return asked[t_ns]

    with mock.patch.object(EmulatedArm, "joint_states", joint_states):
        sessions.run("demo", "demo", out, seed=seed)
    t_ns = np.array(sorted(asked))
    return t_ns * 1e-9, np.stack([asked[t] for t in t_ns])


def angle_row(detected: np.ndarray, std: np.ndarray, truth: np.ndarray) -> str:
    """RMSE, stated std and how often the truth lies within two of them, after the offset."""
    seen = np.isfinite(detected) & np.isfinite(std)
    error = (detected - truth)[seen]
    error = error - np.average(error, weights=std[seen] ** -2)
    within = np.mean(np.abs(error) < 2 * std[seen])
    values = np.degrees([np.sqrt(np.mean(error**2)), np.median(np.abs(error)), np.median(std[seen])])
    return "  ".join(f"{value:10.4f}" for value in values) + f"  {100 * within:8.1f}"


def main() -> None:
    """Print a row a joint."""
    seed = int(sys.argv[1]) if len(sys.argv) > 1 else 0
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "demo"
        t_true_s, q_true = capture_with_truth(out, seed)
        session = fitting.load_session(out)
        fitted = read_fit(out / "fit")
        tree, states = fitted.tree, fitted.states
    start_s = session.recording.start_ns * 1e-9
    rig = load_rig("demo")
    assert rig.table.simulation is not None
    stage = Stage(rig.table, rig.table.simulation, rig.camera_model, seed)
    print(f"{'':9}  {'angle [deg], after the offset':^44}  {'axis [deg]':^15}  {'point [mm]':^15}")
    print(f"{'joint':9}  {'RMSE':>10}  {'median':>10}  {'std':>10}  {'% in 2 std':>8}" + "    error      std" * 2)
    for j, name in enumerate(JOINTS):
        assert states.std is not None
        truth = np.interp(states.t_s + start_s, t_true_s, q_true[:, j])
        row = angle_row(states.state(name), states.std[:, states.joints.index(name)], truth)
        joint, drawn = tree.joint(name), stage.tree.joint(name)
        T_body_part = next(p.T_body_marker for p in stage.plates if p.body == BODIES.index(joint.parent))
        T_part_body = se3.inverse(T_body_part)
        axis = T_part_body[:3, :3] @ drawn.axis_parent
        point = T_part_body[:3, :3] @ drawn.point_parent_m + T_part_body[:3, 3]
        off = joint.point_parent_m - point
        turn = np.degrees(np.arctan2(np.linalg.norm(np.cross(axis, joint.axis_parent)), abs(axis @ joint.axis_parent)))
        far = 1e3 * np.linalg.norm(off - axis * (off @ axis))
        axis_std, point_std = np.degrees(joint.axis_std_rad), 1e3 * joint.point_std_m
        print(f"{name:9}  {row}    {turn:7.4f}  {axis_std:7.4f}  {far:7.4f}  {point_std:7.4f}")


if __name__ == "__main__":
    main()
