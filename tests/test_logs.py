"""What a JointLog refuses; what a PoseLog refuses is in tests/fit/test_bad_input.py, through the fit."""

from __future__ import annotations

import numpy as np
import pytest

from station.errors import InvalidData
from station.logs import JointLog

Q = np.zeros((3, 2))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            {"q": np.where(np.eye(3, 2, -1, dtype=bool), np.inf, 0.0)},
            "the state of 'pan' in row 1 is inf; want a finite",
        ),
        ({"std": -np.eye(3, 2, -1)}, "the standard deviation of 'pan' in row 1 is -1; want a finite"),
        ({"std": np.zeros((3, 1))}, "deviations have shape .3, 1.; want .3, 2."),
        ({"q": np.zeros(3)}, "states have shape .3,.; want .3, 2."),
        ({"t_s": [0.0, 1.0, 1.0]}, "t = 1 s in row 2 follows 1 s"),
        ({"joints": ("pan", "pan")}, "joint named twice: pan"),
        ({"joints": "ab"}, "joints: have 'ab'; want a name for each"),
        ({"units": ("rad", "deg")}, "want one of rad, m"),
        ({"q": [["0", "0"]] * 3}, "joint states: have an array of <U1; want real numbers"),
    ],
)
def test_joint_states_that_are_none_are_refused_with_the_place(changes: dict[str, object], message: str):
    good: dict[str, object] = {"t_s": np.arange(3.0), "joints": ("pan", "lift"), "q": Q, "units": ("rad", "rad")}
    JointLog(**good)  # type: ignore[arg-type]
    with pytest.raises(InvalidData, match=message):
        JointLog(**good | changes)  # type: ignore[arg-type]


def test_states_that_are_unknown_are_none_of_that():
    log = JointLog(np.arange(3.0), ("pan", "lift"), Q * np.nan, ("rad", "m"), Q * np.nan)
    assert np.isnan(log.q).all() and not log.q.flags.writeable
