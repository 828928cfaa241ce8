"""The servo models' files are read strictly: what they don't know, and what can't be true, is refused."""

from __future__ import annotations

import copy
import tomllib
from collections.abc import Callable
from importlib.resources import files
from typing import Any

import pytest

from drivers.errors import DriverError
from drivers.servo_models import load_model
from drivers.servo_models.files import build_model, read_model

Parts = list[dict[str, Any]]
FOLDER = files("drivers.servo_models")


def parts_of(stem: str) -> Parts:
    """A model's tables and, last, its own file, as read."""
    own = tomllib.loads((FOLDER / "models" / f"{stem}.toml").read_text("utf-8"))
    return [
        *(tomllib.loads((FOLDER / "tables" / f"{name}.toml").read_text("utf-8")) for name in own["tables"]),
        own,
    ]


def row(parts: Parts, name: str) -> dict[str, Any]:
    return next(row for part in parts for row in part.get("registers", ()) if row["name"] == name)


def test_the_untouched_files_make_the_model() -> None:
    built, loaded = build_model(parts_of("xm430_w350"), "here"), load_model("XM430-W350")
    assert dict(built.registers) == dict(loaded.registers)
    assert built.sources == loaded.sources


def test_of_two_parts_the_later_one_counts_and_lists_are_joined() -> None:
    parts = parts_of("xl330_m288")
    model = build_model(parts, "here")
    assert model.register("baud_rate").maximum == 6  # x330's, over x's 7
    assert model.register("shutdown").initial == 53  # the model's, over x's 52
    assert (model.register("max_voltage_limit").initial, model.register("max_voltage_limit").maximum) == (70, 70)
    assert 3 not in model.error_bits
    assert 7 not in model.baud_codes
    assert len(model.sources) == len(parts[0]["sources"]) + len(parts[-1]["sources"])
    half = copy.deepcopy(parts)
    half[-1]["override"]["max_voltage_limit"] = {"initial": 60}  # the range stays x330's
    limit = build_model(half, "here").register("max_voltage_limit")
    assert (limit.initial, limit.minimum, limit.maximum) == (60, 31, 70)


def unknown_key(parts: Parts) -> None:
    parts[-1]["colour"] = "black"


def unknown_register_key(parts: Parts) -> None:
    row(parts, "led")["adress"] = 65


def unknown_override_key(parts: Parts) -> None:
    parts[-1]["override"]["led"] = {"address": 66}


def missing_key(parts: Parts) -> None:
    del parts[0]["recovery"]


def text_for_a_number(parts: Parts) -> None:
    parts[-1]["model_number"] = "1020"


def number_for_a_truth(parts: Parts) -> None:
    parts[0]["sync_read"] = 1


def fraction_for_a_count(parts: Parts) -> None:
    row(parts, "led")["address"] = 65.0


def unknown_recovery(parts: Parts) -> None:
    parts[0]["recovery"] = "hope"


def unknown_measure(parts: Parts) -> None:
    parts[0]["units"]["speed"] = [1, 0.229, "furlongs"]


def unknown_unit(parts: Parts) -> None:
    row(parts, "present_velocity")["unit"] = "velocity"


def unknown_bound(parts: Parts) -> None:
    row(parts, "goal_pwm")["within"] = "pwm_limits"


def unknown_override(parts: Parts) -> None:
    parts[-1]["override"]["velocity_limits"] = {"initial": 3}


def unknown_unverified(parts: Parts) -> None:
    parts[-1]["unverified"] = {"velocity_limits": "a slip of the pen"}


def unknown_role(parts: Parts) -> None:
    parts[0]["voltage_register"] = "present_voltage"


def register_twice(parts: Parts) -> None:
    parts[-1]["registers"] = [dict(row(parts, "led"), address=66)]


def overlap(parts: Parts) -> None:
    row(parts, "realtime_tick")["address"] = 121


def overlap_with_indirect(parts: Parts) -> None:
    parts[0]["indirect"][0]["data"] = 222


def beyond_the_end(parts: Parts) -> None:
    parts[0]["size_bytes"] = 400


def too_large_for_its_bytes(parts: Parts) -> None:
    row(parts, "led")["max"] = 256


def empty_range(parts: Parts) -> None:
    row(parts, "led")["min"] = 2


def initial_outside(parts: Parts) -> None:
    parts[-1]["override"]["current_limit"]["initial"] = 2000


def wrong_area(parts: Parts) -> None:
    row(parts, "present_temperature")["area"] = "EEPROM"


def speed_in_volts(parts: Parts) -> None:
    row(parts, "profile_velocity")["unit"] = "voltage"


def bound_in_volts(parts: Parts) -> None:
    row(parts, "velocity_limit")["unit"] = "voltage"


def effort_in_rad(parts: Parts) -> None:
    row(parts, "present_current")["unit"] = "angle"


def unknown_baud(parts: Parts) -> None:
    del parts[0]["baud"]["1"]


def unknown_mode(parts: Parts) -> None:
    row(parts, "operating_mode")["initial"] = 2


def supply_that_is_too_low(parts: Parts) -> None:
    parts[-1]["supply_v"] = [5.0, 6.0]


@pytest.mark.parametrize(
    ("spoil", "complaint"),
    [
        (unknown_key, "colour: Extra inputs"),
        (unknown_register_key, r"registers\.\d+\.adress: Extra inputs"),
        (unknown_override_key, r"override\.led\.address: Extra inputs"),
        (missing_key, "recovery: Field required"),
        (text_for_a_number, "model_number: Input should be a valid integer"),
        (number_for_a_truth, "sync_read: Input should be a valid boolean"),
        (fraction_for_a_count, r"registers\.\d+\.address: Input should be a valid integer"),
        (unknown_recovery, "recovery: Input should be 'reboot' or 'torque_limit'"),
        (unknown_measure, r"units\.speed\.2: Input should be 'deg', 'rpm'"),
        (unknown_unit, r"registers\.present_velocity\.unit: no unit 'velocity'; have angle, speed"),
        (unknown_bound, r"registers\.goal_pwm\.within: no register 'pwm_limits'"),
        (unknown_override, r"override\.velocity_limits: no such register"),
        (unknown_unverified, r"unverified\.velocity_limits: no such register or fact"),
        (unknown_role, "no register 'present_voltage'"),
        (register_twice, "'led' appears twice"),
        (overlap, "'realtime_tick' and 'moving' overlap"),
        (overlap_with_indirect, "'indirect_address_1' and 'indirect_data_1' overlap"),
        (beyond_the_end, "'indirect_data_29' ends beyond size_bytes = 400"),
        (too_large_for_its_bytes, "'led': 0 to 256 is no range within 0 to 255"),
        (empty_range, "'led': 2 to 1 is no range"),
        (initial_outside, "'current_limit': initial value 2000 is outside 0 to 1193"),
        (wrong_area, "'present_temperature': EEPROM at 146; the RAM area begins at 64"),
        (speed_in_volts, "'profile_velocity': its unit must be a multiple of rad/s"),
        (bound_in_volts, "'goal_velocity': its unit must be that of 'velocity_limit'"),
        (effort_in_rad, "'present_current': its unit must be a current"),
        (unknown_baud, r"'baud_rate': its initial value is no code of \[baud\]"),
        (unknown_mode, "'operating_mode': operating_modes must name its initial value"),
        (supply_that_is_too_low, "12.0 is outside supply_v 5.0 to 6.0"),
    ],
    ids=lambda case: case.__name__ if callable(case) else "",
)
def test_what_is_wrong_is_refused_with_the_file_and_the_key(spoil: Callable[[Parts], None], complaint: str) -> None:
    parts = copy.deepcopy(parts_of("xm430_w350"))
    spoil(parts)
    with pytest.raises(DriverError, match=rf"servo model file mine\.toml, with its tables: .*{complaint}"):
        build_model(parts, "mine.toml")


def test_at_most_three_complaints_are_told() -> None:
    parts = copy.deepcopy(parts_of("ax_18a"))
    for number in range(5):
        parts[-1][f"key_{number}"] = number
    with pytest.raises(DriverError, match=r"\(and 2 more\)$"):
        build_model(parts, "mine.toml")


def test_a_file_that_is_not_there_is_named() -> None:
    with pytest.raises(DriverError, match=r"no file models/mx_99\.toml"):
        read_model("mx_99")
