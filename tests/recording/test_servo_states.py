"""What the servos say of themselves is recorded and read back to the last bit, with the gaps that there were."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from drivers.safety import ServoState
from station.errors import InvalidData
from station.recording import Recording, RecordingWriter
from tests.made_sessions import START_NS, describe, make_frames, make_session


def state(seed: int) -> ServoState:
    speed, load, voltage, temperature = np.random.default_rng(seed).normal(size=4).tolist()
    return ServoState(seed, speed, load, voltage, temperature)


def test_servo_states_are_read_bit_for_bit(tmp_path: Path) -> None:
    rows = [{7: state(2 * k), 3: state(2 * k + 1)} for k in range(30)]
    with RecordingWriter(tmp_path / "s", describe(), start_ns=START_NS) as writer:
        for k, states in enumerate(rows):
            writer.log_servos(START_NS + k * 20_000_000, states)
    servos = Recording.load(tmp_path / "s").servos
    assert servos.ids == (3, 7)
    np.testing.assert_array_equal(servos.t_s, np.arange(30) * 20_000_000 / 1e9)
    for quantity in ("temperature_c", "voltage_v", "load", "speed_rad_s"):
        expected = [[getattr(states[n], quantity) for n in servos.ids] for states in rows]
        np.testing.assert_array_equal(getattr(servos, quantity), expected)


def test_a_servo_that_says_nothing_for_a_while_is_nan(tmp_path: Path) -> None:
    with RecordingWriter(tmp_path / "s", describe(), start_ns=0) as writer:
        writer.log_servos(1, {1: state(1), 2: state(2)})
        writer.log_servos(2, {2: state(3)})
    servos = Recording.load(tmp_path / "s").servos
    assert np.isnan(servos.load).tolist() == [[False, False], [True, False]]
    assert servos.load[1, 1] == state(3).load


def test_a_servo_that_was_not_there_at_first_is_refused(tmp_path: Path) -> None:
    with RecordingWriter(tmp_path / "s", describe(), start_ns=0) as writer:
        writer.log_servos(1, {1: state(1)})
        with pytest.raises(InvalidData, match=r"servos \[4\] are new"):
            writer.log_servos(2, {4: state(1)})


def test_a_recording_without_servo_states_is_read(tmp_path: Path) -> None:
    servos = Recording.load(make_session(tmp_path / "s", make_frames(2))).servos
    assert servos.ids == () and servos.temperature_c.shape == (0, 0)
