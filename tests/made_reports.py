"""Made-up material for reports: arms that wave, with all that a session may tell of itself."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from station.compare import compare
from station.fit.result import Fit
from station.kinematics.tree import Joint, KinematicTree
from station.logs import FloatArray, JointLog
from station.report import Material, Redoing, Servos, Timing, Visibility

LAG_S = 0.031
COUNT_RAD = float(np.radians(0.29))
STD_RAD = float(np.radians(0.1))


@dataclass(frozen=True)
class Happened:
    """An event."""

    t_s: float
    level: str
    text: str


def events(duration_s: float, steps: int) -> list[Happened]:
    """Steps, a lost bus and a hot servo."""
    halfway = duration_s / 2
    grave = [
        Happened(halfway, "WARN", "no reply from servo 3 (elbow) within 34 ms\nwaiting 10 s for it"),
        Happened(halfway + 1, "ERROR", "servo 5 is at 71 degC; it switches off at 75 degC"),
    ]
    done = [Happened(k * duration_s / steps, "INFO", f"step {k}") for k in range(steps)]
    return sorted([*done, *grave], key=lambda event: event.t_s)


def servos(duration_s: float, count: int) -> Servos:
    """They get warmer; the second one says nothing for a while."""
    t_s = np.linspace(0, duration_s, 100)
    warm = 35 + 10 * (1 - np.exp(-2 * t_s / duration_s))[:, None] + np.arange(count)
    warm[20:30, 1:2] = np.nan
    load = 0.2 * np.sin(t_s[:, None] + np.arange(count))
    names = tuple(f"joint_{n // 2} ({n + 1})" for n in range(count))
    return Servos(t_s, names, warm, 12 - 0.3 * np.abs(load), load)


def timing(frames: int, lost: tuple[int, ...] = ()) -> Timing:
    """Frames at 30 a second and readings at 50, with jitter; some frames are lost."""
    rng = np.random.default_rng(3)
    index = np.delete(np.arange(frames), lost)
    read_s = np.arange(0.0, frames / 30, 0.02) + rng.uniform(0, 0.002, -(-frames * 50 // 30))
    frame_s = index / 30 + rng.uniform(0, 0.004, len(index))
    return Timing(frame_s, index, read_s, read_s + rng.uniform(0.003, 0.006, len(read_s)), latency_s=0.016, fps=30.0)


def chain(names: tuple[str, ...], frames: int) -> KinematicTree:
    """Revolute joints about y, z and x in turn, with the numbers of a fit."""
    bodies = ("base", *(f"{name}_link" for name in names))
    zero = np.eye(4)
    zero[:3, 3] = 0.02, 0.1, 0.01
    found = {
        "probability": {"rigid": 0.0, "prismatic": 1e-5, "revolute": 0.99999},
        "scores": {"criterion": "evidence", "rigid": 12.5, "prismatic": np.nan, "revolute": -8800.25},
        "rms_rotation_rad": 0.001,
        "rms_translation_m": 0.0002,
        "axis_std_rad": float(np.radians(0.05)),
        "point_std_m": 0.00012,
        "outliers": 3,
    }
    joints = tuple(
        Joint(
            name,
            "revolute",
            parent,
            child,
            np.roll([0.0, 1.0, 0.0], k),
            np.array([0.0, 0.05, 0.0]),
            zero,
            state_min=-0.87,
            state_max=0.87,
            frames=frames,
            **found,
        )
        for k, (name, (parent, child)) in enumerate(zip(names, itertools.pairwise(bodies), strict=True))
    )
    method = {"name": "station", "criterion": "evidence", "joint_types": ["rigid", "prismatic", "revolute"]}
    return KinematicTree("base", (*bodies, "base_b"), (("base", "base_b"),), (bodies,), joints, method)


def wave(t_s: FloatArray, joint: int) -> FloatArray:
    """What the joint does, rad."""
    return np.radians(50) * np.sin(2 * np.pi * t_s / (7 + joint) + joint)


def arm_material(names: tuple[str, ...], duration_s: float = 20.0, *, gaps: float = 0.02) -> Material:
    """All of a session whose camera trails by `LAG_S`; a share of the frames is not seen."""
    rng = np.random.default_rng(1)
    t_s, read_s = np.arange(0.1, duration_s, 1 / 30), np.arange(0.0, duration_s, 0.02)
    tree, units = chain(names, len(t_s)), ("rad",) * len(names)
    q = np.stack([wave(t_s - LAG_S, k) for k in range(len(names))], -1)
    q = q + STD_RAD * rng.normal(size=q.shape)
    q[rng.random(q.shape) < gaps] = np.nan
    states = JointLog(t_s, names, q, units, np.full(q.shape, STD_RAD))
    exact = np.stack([wave(read_s, k) for k in range(len(names))], -1)
    measured = JointLog(read_s, names, COUNT_RAD * np.round(exact / COUNT_RAD), units)
    seen = rng.random((len(t_s), len(tree.parts))) > gaps
    tilt_deg = np.clip(45 + 40 * np.sin(t_s / 5), 0, 89)
    T_root_camera = np.diag([1.0, -1.0, -1.0, 1.0])
    T_root_camera[:3, 3] = 0.2, 0.4, 0.9
    lost = tuple(range(200, 203))
    return Material(
        title="an_arm",
        facts={"state": "interrupted", "started": "2024-05-06T07:08:09+00:00", "rig": "wx250s", "seed": "0"},
        fit=Fit(tree, states),
        comparison=compare(states, JointLog(read_s, names, exact, units), measured),
        viewing={name: (t_s, tilt_deg) for name in names},
        readback_steps=dict.fromkeys(names, COUNT_RAD),
        warnings=("joint_3 moved only 2.1 deg: its axis is not identifiable",),
        visibility=Visibility(t_s, tree.parts, seen, np.where(seen, tilt_deg[:, None], np.nan)),
        T_root_camera=T_root_camera,
        timing=timing(int(30 * duration_s), lost),
        servos=servos(duration_s, 9),
        counts={"frames": len(t_s), "dropped_frames": 3, "stale_frames": 2, "bus_errors": 1, "live_view": 44},
        events=events(duration_s, 40),
        redoing=Redoing(
            lines=("station capture rig.toml motion.toml --out ../again", "station fit . --force", "station report ."),
            files={"rig.toml": f'schema = "rig/1"\n\n# {"a long line " * 20}\n', "motion.toml": "repeat = 2\n"},
            versions={"capture-fit-station": "0.1.0", "opencv-contrib-python-headless": "5.0.0.93"},
            method=tree.method,
        ),
    )
