"""Control tables against those of others: of ROBOTIS, that come with the SDK's wheel, and of rustypot.

Where they differ, the difference is listed with its reason, and nothing else may differ.
"""

from __future__ import annotations

import importlib.util
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
import rustypot

from drivers.errors import DriverError
from drivers.servo_models import MODELS, Register, ServoModel, load_model, model_by_number

# ROBOTIS's tables name the first register of each kind, and those at which its own software begins to write and read.
READ_FROM = {662: 29, 228: 7}  # by the table's size
OLD_INDIRECT = "from 224 on here; from 208 on in the manual, in *_fw52.model, and by the room that 20 registers leave"
SDK_DEVIATIONS = {
    (f"{stem}.model", row): OLD_INDIRECT
    for stem in ("xl330_m077", "xl330_m288", "xc330_t181", "xc330_t288", "xc330_m181", "xc330_m288")
    for row in ("indirect_data_1", "indirect_data_write", "indirect_data_read")
}


@dataclass(frozen=True)
class SdkTable:
    """A `.model` file of dynamixel_easy_sdk."""

    file: str
    info: dict[str, float]
    units: dict[str, tuple[float, str, str]]
    rows: dict[str, tuple[int, int]]  # address and size by name


def sdk_folder() -> Path:
    spec = importlib.util.find_spec("dynamixel_easy_sdk")
    assert spec is not None
    assert spec.submodule_search_locations is not None
    return Path(spec.submodule_search_locations[0]) / "control_table"


def read_sdk_table(path: Path) -> SdkTable:
    sections: dict[str, list[list[str]]] = {}
    rows: list[list[str]] = []
    for line in path.read_text("utf-8").splitlines():
        if line.startswith("["):
            rows = sections.setdefault(line.strip("[]"), [])
        elif line.strip():
            rows.append(line.split("\t"))
    return SdkTable(
        path.name,
        {name: float(value) for name, value in sections["type info"][1:]},
        {slug(name): (float(value), unit, sign) for name, value, unit, sign in sections["unit info"][1:]},
        {slug(name): (int(address), int(size)) for address, size, name in sections["control table"][1:]},
    )


def slug(name: str) -> str:
    return name.strip().lower().replace("(shadow)", "").replace(" ", "_")


def sdk_models() -> dict[int, str]:
    """ROBOTIS's list of model numbers and files."""
    lines = (sdk_folder() / "dynamixel.model").read_text("utf-8").split("\n")[1:]
    return {int(number): file.strip() for number, file in (line.split("\t") for line in lines if line.strip())}


def sdk_cases() -> list[Any]:
    """Every file for a model that is here; some models have a second file, for another firmware."""
    cases: list[Any] = []
    for number, file in sdk_models().items():
        if (model := model_by_number(number)) is not None:
            stem = file.removesuffix(".model")
            files = sorted(path.name for path in sdk_folder().glob(f"{stem}*.model"))
            cases += [pytest.param(model.name, name, id=name) for name in files]
    return cases


def own_register(model: ServoModel, row: str) -> Register:
    for kind in ("address", "data"):
        if row == f"indirect_{kind}_write":
            return model.register(f"indirect_{kind}_1")
        if row == f"indirect_{kind}_read":
            return model.register(f"indirect_{kind}_{READ_FROM[model.size_bytes]}")
    return model.register(row)


def test_every_model_with_protocol_2_is_in_the_sdks_list_under_its_number() -> None:
    # MX-28(2.0) is mx_28.model there, XL-320 xl320.model.
    theirs = {file.removesuffix(".model"): number for number, file in sdk_models().items()}
    ours = {
        name.removesuffix("(2.0)").lower().replace("xl-320", "xl320").replace("-", "_"): load_model(name).model_number
        for name in MODELS
        if 2.0 in load_model(name).protocols
    }
    assert len(ours) == 25
    assert ours.items() <= theirs.items()
    assert len(sdk_cases()) == 31  # 6 of the 25 have two files


@pytest.mark.parametrize(("name", "file"), sdk_cases())
def test_addresses_and_sizes_are_robotiss(name: str, file: str) -> None:
    model, table = load_model(name), read_sdk_table(sdk_folder() / file)
    found: set[tuple[str, str]] = set()
    for row, place in table.rows.items():
        register = own_register(model, row)
        if (register.address, register.size) != place:
            found.add((file, row))
    assert found == {key for key in SDK_DEVIATIONS if key[0] == file}
    assert set(model.registers) <= set(table.rows)


@pytest.mark.parametrize(("name", "file"), sdk_cases())
def test_zero_signs_and_speeds_are_robotiss(name: str, file: str) -> None:
    model, table = load_model(name), read_sdk_table(sdk_folder() / file)
    if (
        name == "XL-320"
    ):  # its [type info] is that of a servo with 4096 counts, its [unit info] names no register it has
        assert (model.zero_count, model.resolution) == (512, 1024)
        with pytest.raises(DriverError):
            model.register("present_velocity")
        # 0.11099 rpm there, 0.111 in the manual
        assert model.speed_unit_rad_s == pytest.approx(table.units["present_velocity"][0], rel=1e-4)
        return
    assert table.info["value_of_zero_radian_position"] == model.zero_count
    # 4095 counts in 2 pi there; a revolution is 4096 of them, by the manual and by the encoder's 12 bits.
    assert table.info["value_of_max_radian_position"] == model.resolution - 1
    for row, (amount, unit, sign) in table.units.items():
        register = model.register(row)
        assert (sign == "signed") == (register.encoding == "twos_complement")
        assert register.unit is not None
        if unit == "rad/s":  # 0.22889 rpm there, 0.229 in the manual: half a unit of its last digit is 0.22 %
            assert register.unit.per_count == pytest.approx(amount, rel=0.0022)


# rustypot's differences by model: register, what differs, why.
RAW = "rustypot leaves the direction bit to its caller"
MULTI_TURN = "signed there; the manual gives 0 to the highest count"
READ_ONLY = "the manual's access is R"
LATER = "of later firmware, not listed here"
SIGNED = "two's complement in the manual"
ABSENT = "the manual's table of this model has no such register"
RUSTYPOT_DEVIATIONS: dict[str, dict[tuple[int, str], str]] = {
    "AX-12A": {(address, "encoding"): RAW for address in (32, 38, 40)},
    "MX-28": {(address, "encoding"): RAW for address in (32, 38, 40)}
    | {(address, "encoding"): MULTI_TURN for address in (6, 8)},
    "XL-320": {(address, "encoding"): RAW for address in (32, 39, 41)}
    | {(address, "encoding"): MULTI_TURN for address in (30, 37)},
    "XL330-M288": {(address, "access"): READ_ONLY for address in (6, 69, 70)}
    | {(address, "encoding"): MULTI_TURN for address in (48, 52)}
    | {(address, "encoding"): SIGNED for address in (98, 136, 140)}
    | {(address, "absent"): LATER for address in (60, 147)}
    | {(40, "absent"): ABSENT}
    | {(address, "absent"): OLD_INDIRECT for address in (228, 229)},
    "XL430-W250": {(address, "encoding"): SIGNED for address in (98, 136, 140)}
    | {(address, "absent"): LATER for address in (60, 147)}
    | {(address, "absent"): ABSENT for address in (38, 102)},
}
RUSTYPOT = {
    "AX-12A": rustypot.AxPyController,
    "MX-28": rustypot.MxPyController,
    "XL-320": rustypot.Xl320PyController,
    "XL330-M288": rustypot.Xl330PyController,
    "XL430-W250": rustypot.Xl430PyController,
}


def all_registers(model: ServoModel) -> dict[int, Register]:
    """By address, indirect ones included."""
    found = {register.address: register for register in model.registers.values()}
    for block in model.indirect:
        for number in range(block.first, block.first + block.count):
            for kind in ("address", "data"):
                register = model.register(f"indirect_{kind}_{number}")
                found[register.address] = register
    return found


@pytest.mark.parametrize("name", RUSTYPOT)
def test_addresses_sizes_access_and_signs_are_rustypots(name: str) -> None:
    model, theirs = load_model(name), {entry.addr: entry for entry in RUSTYPOT[name].registers()}
    ours = all_registers(model)
    access = {rustypot.RegisterAccess.Read: False, rustypot.RegisterAccess.ReadWrite: True}
    found: set[tuple[int, str]] = set()
    for address, entry in theirs.items():
        if (register := ours.get(address)) is None:
            found.add((address, "absent"))
            continue
        if register.size != entry.size:
            found.add((address, "size"))
        if register.writable != access[entry.access]:
            found.add((address, "access"))
        if register.encoding != entry.encoding:
            found.add((address, "encoding"))
    assert found == set(RUSTYPOT_DEVIATIONS[name])
    assert {register.address for register in model.registers.values()} <= set(theirs)


@pytest.mark.parametrize("name", RUSTYPOT)
def test_resolutions_and_bauds_are_rustypots(name: str) -> None:
    model, theirs = load_model(name), RUSTYPOT[name]
    assert theirs.resolution() == model.resolution
    assert theirs.word_order() == "little"
    ours = {baud: code for code, baud in model.baud_codes.items()}
    assert theirs.baudrates().items() <= ours.items()  # it knows no rate over 4 Mbps, and none of protocol 1.0 servos
