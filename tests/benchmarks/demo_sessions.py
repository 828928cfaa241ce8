"""Recordings of the demo, each with the true states of the emulated arm beside it; kept, if wanted, for later runs."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from unittest import mock

import numpy as np

from calibration.intrinsics import CameraModel
from station.commands import capturing
from station.emulated_arm import EmulatedArm
from station.logs import FloatArray, JointLog
from station.perception.markers import MarkerTable
from station.perception.observations import ObservationLog
from station.recording import Recording
from station.rig import load_rig
from station.stage import Stage
from tests.benchmarks.rendered_truth import Truth

RIG = MOTION = "demo"
TRUTH_FILE = "truth.npz"


@dataclass(frozen=True, eq=False)
class DemoSession:
    """A recording and the truth.

    Attributes:
        folder: the session.
        observations: corners at the middle of their frames' exposures.
        measured: the servos' read-back.
        table: of the markers.
        truth: the emulated arm before the rendered camera.
    """

    folder: Path
    observations: ObservationLog
    measured: JointLog
    table: MarkerTable
    truth: Truth


def demo_session(folder: Path, seed: int) -> DemoSession:
    """The session of a seed in `folder`: captured, if there is none yet."""
    if not (folder / TRUTH_FILE).exists():
        t_ns, q = _capture(folder, seed)
        np.savez(folder / TRUTH_FILE, t_ns=t_ns, q=q)
    with np.load(folder / TRUTH_FILE) as stored:
        t_ns, q = stored["t_ns"], stored["q"]
    recording = Recording.load(folder)
    rig = load_rig(RIG)
    assert rig.table.simulation is not None
    stage = Stage(rig.table, rig.table.simulation, rig.camera_model, seed)
    seen = recording.observations
    return DemoSession(
        folder,
        replace(seen, t_s=seen.t_s - rig.table.camera.latency_s),
        recording.measured,
        rig.table.marker_table(),
        _truth(stage, (t_ns - recording.start_ns) * 1e-9, q, rig.camera_model),
    )


@contextmanager
def demo_folder(kept_in: Path | None, seed: int) -> Iterator[Path]:
    """Where the session of a seed goes: for a while only, unless a folder is named that keeps it."""
    if kept_in is not None:
        yield kept_in / f"demo_{seed}"
        return
    with TemporaryDirectory() as folder:
        yield Path(folder) / f"demo_{seed}"


def _capture(out: Path, seed: int) -> tuple[FloatArray, FloatArray]:
    """Capture into `out`; times [ns of the monotonic clock] and true states (I, J) at which pictures were rendered."""
    asked: dict[int, FloatArray] = {}
    true_states = EmulatedArm.joint_states

    def joint_states(self: EmulatedArm, t_ns: int) -> FloatArray:
        asked[t_ns] = true_states(self, t_ns)
        return asked[t_ns]

    with mock.patch.object(EmulatedArm, "joint_states", joint_states):
        capturing.capture(RIG, MOTION, out, seed=seed)
    t_ns = np.array(sorted(asked))
    return t_ns, np.stack([asked[t] for t in t_ns.tolist()])


def _truth(stage: Stage, t_s: FloatArray, q: FloatArray, camera: CameraModel) -> Truth:
    """By straight lines between the instants of an exposure, milliseconds apart."""

    def states(at_s: FloatArray) -> FloatArray:
        return np.stack([np.interp(at_s, t_s, column) for column in q.T], axis=-1)

    return Truth(stage, states, camera)
