"""Joint states that the camera sees while a capture is recorded, the tree known."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from station.capture.live_states import Beside, camera_numbers
from station.capture.live_view import LiveDetected, QueuedView
from station.capture.snapshot import Snapshot
from station.commands import capturing, fitting
from station.errors import StationError
from station.fit.image.live import StateFollower
from station.formats.rig import parse_rig
from station.formats.trees import load_tree
from station.kinematics.tree import KinematicTree
from station.kinematics.tree_json import to_json
from station.recording import Recording
from station.rig_reading import read_rig
from station.seen_columns import seen_columns
from tests.sessions import copy_of_short, write_motion
from tests.test_hand_capture import DOOR
from tests.test_live_view import PATIENCE_S, MadeScreen

# Of a servo's read-back, which is quantised to 0.088 deg and in between two readings, to what the camera sees.
NEAR_RAD = np.deg2rad(0.3)
# How much older than a snapshot what it shows may be.
LATE_S = 2.0


@pytest.fixture(scope="module")
def fitted(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A fitted session of the demo rig."""
    session = copy_of_short(tmp_path_factory.mktemp("fitted"))
    fitting.fit(session)
    return session


@pytest.fixture(scope="module")
def seen(fitted: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[Snapshot]]:
    """Another session of the same rig, and what was shown of it."""
    folder, shots = tmp_path_factory.mktemp("seen"), []
    capturing.capture("demo", write_motion(folder), folder / "session", seed=0, tree=fitted, watch=shots.append)
    return folder / "session", shots


def test_the_recording_has_the_states_of_every_frame_near_what_the_servos_say(seen: tuple[Path, list]) -> None:
    recording = Recording.load(seen[0])
    states, measured = recording.live_states, recording.measured
    assert states.joints == recording.description.joints == ("base_pan", "shoulder", "elbow", "wrist")
    np.testing.assert_array_equal(states.t_s, recording.observations.t_s)
    latency_s = parse_rig(recording.description.rig or "", "rig").camera.latency_s
    said = np.column_stack([np.interp(states.t_s - latency_s, measured.t_s, q) for q in measured.q.T])
    off = states.q - said
    assert np.isfinite(off).mean() > 0.95
    assert np.nanmax(np.abs(off - np.nanmedian(off, axis=0))) < NEAR_RAD
    assert states.std is not None
    assert 0 < np.nanmax(states.std) < NEAR_RAD


def test_what_is_shown_counts_from_the_arms_zeros(seen: tuple[Path, list[Snapshot]]) -> None:
    shown = [joint for shot in seen[1] for joint in shot.joints if joint.detected is not None]
    assert len(shown) > 10
    measured = Recording.load(seen[0]).measured
    t_s = np.linspace(measured.t_s[0], measured.t_s[-1], 10 * len(measured.t_s))
    q = np.column_stack([np.interp(t_s, measured.t_s, q) for q in measured.q.T])
    for shot in seen[1]:  # a frame's states are older than the last reading, by as much as the machine is busy
        lately = np.abs(t_s - shot.t_s) < LATE_S
        for j, joint in enumerate(shot.joints):
            if joint.detected is not None:
                assert np.min(np.abs(q[lately, j] - joint.detected)) < NEAR_RAD


def test_a_fit_later_finds_what_it_finds_without(seen: tuple[Path, list], fitted: Path, tmp_path: Path) -> None:
    again, before = fitting.fit(seen[0], tmp_path / "fit").fit, fitting.fit(fitted, tmp_path / "before").fit
    np.testing.assert_allclose(again.states.q, before.states.q, atol=1e-6)


def test_a_session_in_which_nobody_looked_on_has_no_such_states(fitted: Path) -> None:
    assert Recording.load(fitted).live_states.joints == ()


def test_what_fails_while_looking_on_is_said_once_and_ends_nothing(
    fitted: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    frames: list[object] = []

    def failing(self: StateFollower, views: object) -> None:
        frames.append(views)
        raise ValueError("no convergence")

    monkeypatch.setattr(StateFollower, "follow", failing)
    counts = capturing.capture("demo", write_motion(tmp_path), tmp_path / "session", tree=fitted / "fit")
    recording = Recording.load(tmp_path / "session")
    said = [event.text for event in recording.events if event.level == "WARN"]
    assert said == ["joint states are no longer estimated: no convergence"]
    assert len(frames) == 1
    assert counts.frames == recording.frames > 50


def test_a_tree_of_something_else_is_refused_before_anything_is_made(tmp_path: Path) -> None:
    with pytest.raises(StationError, match="no marker is on a part of the tree; the tree has frame, pedal"):
        capturing.capture("demo", write_motion(tmp_path), tmp_path / "session", tree=strange(tmp_path))
    assert not (tmp_path / "session").exists()


def strange(folder: Path) -> Path:
    path = folder / "kinematics.json"
    path.write_text(to_json(KinematicTree("frame", ("frame", "pedal"), (), (("frame",), ("pedal",)), ())))
    return path


def test_a_door_without_servos_is_seen_too(tmp_path: Path) -> None:
    rig = tmp_path / "door.toml"
    rig.write_text(DOOR, encoding="utf-8")
    shots: list[Snapshot] = []
    settings: dict[str, Any] = {"ask": lambda _: None, "duration_s": 5.0, "seed": 1}
    capturing.capture_by_hand(str(rig), tmp_path / "first", **settings)
    tree = fitting.fit(tmp_path / "first").fit.tree
    capturing.capture_by_hand(str(rig), tmp_path / "second", tree=tmp_path / "first", watch=shots.append, **settings)
    states = Recording.load(tmp_path / "second").live_states
    assert states.joints == tree.columns != ()
    assert np.isfinite(states.q).mean() > 0.9
    assert set(shots[-1].detected) == set(tree.columns)


def test_joints_of_the_arm_come_first_and_those_that_the_tree_lacks_have_no_state(fitted: Path) -> None:
    rig, _, _ = read_rig("demo")
    tree = load_tree(fitted / "fit")
    renamed = replace(
        tree, joints=tuple(replace(joint, name="lid") if joint.name == "shoulder" else joint for joint in tree.joints)
    )
    columns = seen_columns(rig, renamed)
    assert columns.names == ("base_pan", "shoulder", "elbow", "wrist", "lid")
    q = columns.ordered(np.arange(4.0))
    assert np.isnan(q[1])
    assert [q[columns.names.index(name)] for name in renamed.columns] == [0.0, 1.0, 2.0, 3.0]


def test_states_are_shown_with_the_constant_by_which_the_servos_differ() -> None:
    beside = Beside(3, 2, latency_s=0.01)
    for k in range(50):
        t_ns = k * 20_000_000
        beside.read(t_ns, np.array([0.1 * k, -0.2 * k]))
    at_ns, exposed = 505_000_000, (505 - 10) / 20  # in turns of the servo loop
    q = np.array([0.1 * exposed + 2.0, np.nan, 0.7])
    shown = beside.shown(at_ns, q)
    assert shown[0] == pytest.approx(0.1 * exposed)
    assert np.isnan(shown[1])
    assert shown[2] == 0.7
    assert beside.shown(at_ns + 10_000_000, q + 0.05)[0] == pytest.approx(0.1 * exposed + 0.05, abs=0.01)


def test_the_shift_of_edges_is_the_one_that_the_tree_was_fitted_with(fitted: Path) -> None:
    tree = load_tree(fitted / "fit")
    numbers = camera_numbers(tree, 0.02)
    assert numbers is not None
    assert (numbers.edge_shift_px, numbers.readout_s) == (tree.method["camera"]["edge_shift_px"]["value"], 0.02)  # type: ignore[index]
    assert camera_numbers(replace(tree, method={}), 0.0) is None


def test_the_live_view_is_shown_what_was_seen_without_waiting_for_it() -> None:
    screen = MadeScreen()
    screen.goes_on.set()
    shown: list[tuple[Any, Any]] = []
    screen.show_detected = lambda t_ns, q: (shown.append((t_ns, q)), screen.reached.set())  # type: ignore[attr-defined]
    with QueuedView(screen) as view:
        view.offer(LiveDetected(7, np.array([0.1, np.nan])))
        assert screen.reached.wait(PATIENCE_S)
    ((t_ns, q),) = shown
    assert t_ns.tolist() == [7] and q.shape == (1, 2)
