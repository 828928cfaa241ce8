"""The dashboard holds what a person needs to know of a capture, in 80 x 24 characters and in less."""

from __future__ import annotations

import io
from dataclasses import replace

import pytest
from rich.console import Console

from station.capture.snapshot import JointSnapshot, Snapshot
from station.capture.states import State
from station.cli.dashboard import Dashboard, duration


def joint(k: int = 0, **changes: object) -> JointSnapshot:
    made = JointSnapshot(f"joint_{k}", "rad", 0.5, 0.6, 41.0, 11.9, 0.12, 0.3)
    return replace(made, **changes)  # pyright: ignore[reportArgumentType]


def snapshot(**changes: object) -> Snapshot:
    lost = {"camera": 0, "detection": 0, "live view": 7}
    made = Snapshot(State.MOVING, 12.0, 62.4, 300.0, "step 3 of 12", (joint(),), 371, 29.97, lost, {}, 0, "")
    return replace(made, **changes)  # pyright: ignore[reportArgumentType]


def drawn(now: Snapshot, width: int = 80, asked: str = "", foot: str = "Ctrl-C pauses") -> list[str]:
    console = Console(width=width, height=24, file=io.StringIO(), color_system=None)
    with console.capture() as captured:
        console.print(Dashboard(now, "76.5 GB left", asked, foot))
    return captured.get().splitlines()


@pytest.mark.parametrize("width", [80, 60, 40, 30])
@pytest.mark.parametrize("joints", [0, 1, 4, 8])
@pytest.mark.parametrize("parts", [0, 1, 20])
def test_it_fits(width: int, joints: int, parts: int):
    now = snapshot(
        state=State.PAUSED,
        step="step 3 of 12: base_pan to 40 deg, elbow to -30 deg, wrist to 10 deg and back again",
        joints=tuple(joint(k) for k in range(joints)),
        lost=dict.fromkeys(("camera", "detection", "recorder", "images", "live view"), 12345),
        seen_s={f"part_{k}": None if k == 7 else 1.3 * k for k in range(parts)},
        bus_errors=12,
        said="servo 3 (elbow) is 71 degC hot; its own limit is 75 degC: let it rest, or lower speed_deg_s. " * 3,
    )
    lines = drawn(now, width, "paused: the arm holds where it is. Enter: on from the last checkpoint.", "live view x")
    assert max(map(len, lines)) <= width
    assert len(lines) <= 24
    assert all(any(f"joint_{k}" in line for line in lines) for k in range(joints))


def test_it_says_how_far_the_motion_is():
    text = "\n".join(drawn(snapshot()))
    assert "MOVING" in text and "step 3 of 12" in text
    assert "1:02 of 5:00" in text and "21 %" in text and "3:57 left" in text


def test_a_capture_by_hand_has_no_end_to_show():
    text = "\n".join(drawn(snapshot(total_s=None, joints=(joint(goal=None),))))
    assert "1:02" in text and "%, " not in text and "limp" in text


def test_what_the_live_view_left_out_is_no_loss():
    assert "lost none   not shown live 7" in "\n".join(drawn(snapshot()))
    lost = "\n".join(drawn(snapshot(lost={"camera": 2, "detection": 0, "recorder": 1, "live view": 0})))
    assert "lost camera 2, recorder 1" in lost and "not shown" not in lost


def test_parts_that_are_not_seen_are_named_with_the_longest_first():
    seen: dict[str, float | None] = {"base": 0.1, "lid": 3.2, "knob": None, "link1": 0.4, "arm": 61.0}
    assert "parts 2 of 5 seen; not knob never, arm for 61 s, lid for 3 s" in "\n".join(drawn(snapshot(seen_s=seen)))
    assert "part_0 for 9 s, 5 more" in "\n".join(drawn(snapshot(seen_s={f"part_{k}": 9.0 for k in range(6)}), width=60))


def test_enough_motion_is_shown_for_each_joint_once_it_is_known():
    shares = (None, 0.0, 0.62, 1.0)
    text = "\n".join(drawn(snapshot(joints=tuple(joint(k, motion_share=share) for k, share in enumerate(shares)))))
    assert "enough motion?" in text and "62 %" in text and "yes" in text
    assert "enough motion?" not in "\n".join(drawn(snapshot(joints=(joint(motion_share=None),))))


def test_where_it_is_narrow_what_matters_least_goes_first():
    header = [next(line for line in drawn(snapshot(), width) if line.startswith("joint")) for width in (80, 45, 30, 18)]
    assert [name in header[0] for name in ("at", "goal", "temp", "volt", "load", "enough motion?")] == [True] * 6
    assert "enough motion?" in header[1] and "volt" not in header[1]
    assert "goal" in header[2] and "temp" not in header[2]
    assert header[3].split() == ["joint", "at"]


def test_angles_are_in_degrees_and_slides_in_millimetres():
    text = "\n".join(drawn(snapshot(joints=(joint(q=0.5), joint(1, unit="m", q=0.0123, goal=0.02)))))
    assert "28.6°" in text and "12.3 mm" in text and "20.0 mm" in text


@pytest.mark.parametrize(("seconds", "told"), [(0, "0:00"), (65.9, "1:05"), (7207, "2:00:07"), (-1, "0:00")])
def test_times_are_told_in_minutes(seconds: float, told: str):
    assert duration(seconds) == told


def test_what_is_warm_is_yellow_and_what_is_hot_is_red():
    def styles(**changes: object) -> set[str]:
        lines = Dashboard(snapshot(joints=(joint(motion_share=None, **changes),))).lines(80)
        return {str(span.style) for line in lines if "joint_0" in line.plain for span in line.spans}

    assert not styles(temperature_c=59.0, load=-0.69) & {"yellow", "bold red"}
    assert "yellow" in styles(temperature_c=60.0, load=0.0) and "yellow" in styles(load=-0.7)
    assert "bold red" in styles(temperature_c=70.0, load=0.0) and "bold red" in styles(load=-0.9)


def test_what_the_camera_sees_of_a_joint_is_beside_where_the_servos_say_it_is():
    joints = (joint(0, detected=0.5012), joint(1), joint(2, detected=None))
    head, first, second = drawn(snapshot(joints=joints))[2:5]
    assert head.split()[:4] == ["joint", "at", "seen", "goal"]
    assert first.split()[:4] == ["joint_0", "28.6°", "28.72°", "34.4°"]
    assert "unseen" in second


def test_joints_that_the_arm_does_not_have_are_shown_by_their_names():
    now = snapshot(
        joints=(), detected={"base__lid": (0.5, "rad"), "base__drawer": (0.0123, "m"), "lid__knob": (None, "rad")}
    )
    assert "seen base__lid 28.65°, base__drawer 12.30 mm, lid__knob unseen" in "\n".join(drawn(now))
