"""The keys of a model with its tables, checked strictly: unknown keys and other types are refused."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field

Slug = Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]*$")]
Natural = Annotated[int, Field(ge=0)]
Count = Annotated[int, Field(gt=0)]
Positive = Annotated[float, Field(gt=0)]
Text = Annotated[str, Field(min_length=1)]
Protocol = Annotated[float, Field(ge=1.0, le=2.0, multiple_of=1.0)]
FromList = Field(strict=False)  # TOML has lists only; the members stay strict
BitNames = dict[Literal["0", "1", "2", "3", "4", "5", "6", "7"], Slug]
Measure = Literal["deg", "rpm", "rpm2", "deg/s2", "percent", "mA", "V", "mV/ms", "degC", "us", "ms"]


class Strict(BaseModel):
    """A table that refuses unknown keys and doesn't turn one type into another."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True, allow_inf_nan=False)


class RegisterRow(Strict):
    """A row of `registers`."""

    name: Slug
    address: Natural
    size: Literal[1, 2, 4]
    area: Literal["EEPROM", "RAM"]
    access: Literal["R", "RW"]
    encoding: Literal["unsigned", "twos_complement", "sign_magnitude"] = "unsigned"
    initial: int | None = None
    min: int | None = None
    max: int | None = None
    unit: Slug | None = None
    zero: int = 0
    within: Slug | None = None


class Override(Strict):
    """What a model or a later table says otherwise of a register."""

    initial: int | None = None
    min: int | None = None
    max: int | None = None


class Nominal(Strict):
    """Speed and torque at one voltage."""

    v: Positive
    no_load_rpm: Positive
    stall_nm: Positive
    stall_a: Positive


class IndirectRow(Strict):
    """A block of indirect registers."""

    first: Count
    count: Count
    address: Natural
    data: Natural


class ModelTable(Strict):
    """A model's own file and the tables that it names, merged; `drivers.servo_models.model` says what the keys mean."""

    name: Text
    model_number: Count
    tables: Annotated[list[Slug], Field(min_length=1)]
    protocols: Annotated[list[Protocol], Field(min_length=1)]
    resolution: Count
    zero_count: Natural
    sync_read: bool
    bulk_read: bool
    fast_sync_read: bool | None = None
    recovery: Literal["reboot", "torque_limit"]
    eeprom_lock: Literal["torque_enable", "lock"]
    sync_cable: bool = False
    supply_v: Annotated[tuple[Positive, Positive], FromList]
    nominal: Nominal
    size_bytes: Count
    registers: list[RegisterRow]
    override: dict[Slug, Override] = {}
    indirect: list[IndirectRow] = []
    speed_register: Slug
    acceleration_register: Slug | None = None
    present_speed_register: Slug
    effort_register: Slug
    voltage_register: Slug
    position_limit_registers: Annotated[tuple[Slug, Slug], FromList]
    registered_flag: Slug
    hardware_error_register: Slug | None = None
    operating_mode_register: Slug | None = None
    operating_modes: dict[Slug, Natural] = {}
    drive_mode_bits: BitNames = {}
    error_bits: BitNames
    baud: Annotated[dict[Annotated[str, Field(pattern=r"^\d+$")], Count], Field(min_length=1)]
    units: dict[Slug, Annotated[tuple[Count, Positive, Measure], FromList]]
    unverified: dict[Slug, Text] = {}
    sources: Annotated[list[Text], Field(min_length=1)]
