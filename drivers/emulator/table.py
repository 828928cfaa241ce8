"""The memory of an emulated servo: registers, what a read or write of bytes means, and what the table alone refuses."""

from __future__ import annotations

from collections.abc import Sequence
from enum import Enum
from functools import cache

from drivers.servo_models import Register, ServoModel
from drivers.servo_models.register import DIRECTION_BIT, MAGNITUDE


class Refusal(Enum):
    """Why a servo doesn't do what it is told; the bus puts it into its protocol's error byte."""

    INSTRUCTION = "instruction"
    RANGE = "range"
    LENGTH = "length"
    LIMIT = "limit"
    ACCESS = "access"
    RESULT = "result"


class Refused(Exception):
    """Raised by a servo that refuses an instruction; it never leaves the emulator."""

    def __init__(self, reason: Refusal) -> None:
        super().__init__(reason.value)
        self.reason = reason


class Cell:
    """Where a register's bytes are, and what they can hold: what `Register.encode` finds out anew each time."""

    __slots__ = ("_magnitude", "_signed", "end", "high", "low", "modulus", "size", "start")

    def __init__(self, register: Register) -> None:
        self.start, self.size = register.address, register.size
        self.end = register.address + register.size
        self.low, self.high = register.span
        self.modulus = 1 << 8 * register.size
        self._magnitude = register.encoding == "sign_magnitude"
        self._signed = register.encoding == "twos_complement"

    def value(self, memory: bytearray) -> int:
        """What the register holds."""
        value = int.from_bytes(memory[self.start : self.end], "little", signed=self._signed)
        if self._magnitude:
            return -(value & MAGNITUDE) if value & DIRECTION_BIT else value & MAGNITUDE
        return value

    def bytes(self, value: int) -> bytes:
        """Bytes of the nearest value that the register can hold."""
        value = self.low if value < self.low else min(value, self.high)
        if self._magnitude and value < 0:
            value = DIRECTION_BIT - value
        return (value % self.modulus).to_bytes(self.size, "little")


class Table:
    """The control table of one servo, as bytes."""

    def __init__(self, model: ServoModel) -> None:
        self.model = model
        self.registers, self.cells = _named(model)
        self._owners = _owners(model)
        self._memory = bytearray(model.size_bytes)

    def __contains__(self, name: str) -> bool:
        return name in self.registers

    def get(self, name: str) -> int:
        """The value of a register."""
        return self._cell(name).value(self._memory)

    def set(self, name: str, value: int) -> None:
        """Set a register, whatever its access and range."""
        self.fill(self._cell(name), value)

    def put(self, register: Register, value: int) -> None:
        """Set a register to the nearest value that its bytes can hold."""
        self.fill(self.cells[register.name], value)

    def fill(self, cell: Cell, value: int) -> None:
        """Set the bytes of a cell to a value."""
        self._memory[cell.start : cell.end] = cell.bytes(value)

    def covers_indirect_data(self, address: int, length: int) -> bool:
        """Whether these bytes hold indirect data, which may stand for any register."""
        for block in self.model.indirect:
            if address < block.data + block.count and block.data < address + length:
                return True
        return False

    def read(self, address: int, length: int) -> bytes:
        """Bytes of the control table; gaps between registers read as zeros."""
        if length < 1 or address + length > self.model.size_bytes:
            raise Refused(Refusal.ACCESS)
        if self.covers_indirect_data(address, length):
            return bytes(self._memory[self._target(at)] for at in range(address, address + length))
        return bytes(self._memory[address : address + length])

    def entries(self, address: int, data: bytes) -> list[tuple[Register, int]]:
        """The registers that these bytes cover, each with its value.

        Refused if a register is covered in part, or a byte is no register's. A byte of indirect data is a byte of the
        register that its indirect address names (e-manual, Indirect Address).
        """
        if not data or address + len(data) > self.model.size_bytes:
            raise Refused(Refusal.ACCESS)
        targets = [self._target(at) for at in range(address, address + len(data))]
        owners = [self._owners[at] for at in targets]
        entries: list[tuple[Register, int]] = []
        k = 0
        while k < len(data):
            owner = owners[k]
            if owner is None:
                raise Refused(Refusal.ACCESS)
            end = k + owner.size
            if targets[k:end] != list(range(owner.address, owner.address + owner.size)):
                raise Refused(Refusal.LENGTH)
            entries.append((owner, owner.decode(data[k:end])))
            k = end
        return entries

    def check(self, register: Register, value: int) -> None:
        """Raise Refused if the register doesn't take this value now, by its access, lock and ranges."""
        if not register.writable:
            raise Refused(Refusal.ACCESS)
        # X: EEPROM is locked while torque is on (X-series manual, Control Table). AX: by Lock (47) alone.
        locked = bool(self.get(self.model.eeprom_lock))
        if register.area == "EEPROM" and locked:
            raise Refused(Refusal.ACCESS)
        if register.name == "lock" == self.model.eeprom_lock and locked and value == 0:
            raise Refused(Refusal.ACCESS)  # e-manual, Lock (47): only a power cycle unlocks
        if register.minimum is not None and value < register.minimum:
            raise Refused(Refusal.RANGE)
        if register.maximum is not None and value > register.maximum:
            raise Refused(Refusal.RANGE)
        if register.within is not None and abs(value) > abs(self.get(register.within)):
            raise Refused(Refusal.LIMIT)
        if register.name == self.model.operating_mode_register and value not in self.model.operating_modes.values():
            raise Refused(Refusal.RANGE)

    def power_up(self, keep: Sequence[str]) -> None:
        """All registers to their initial values, but for those to keep."""
        for register in self.registers.values():
            if register.name not in keep:
                self.put(register, register.initial or 0)

    def _cell(self, name: str) -> Cell:
        cell = self.cells.get(name)
        return cell or self.cells[self.model.register(name).name]  # which raises, with the names that there are

    def _target(self, address: int) -> int:
        """Where a byte of the table is: behind its indirect address if it is indirect data.

        An indirect address that names indirect data is followed once. Unverified: the manual doesn't tell.
        """
        for block in self.model.indirect:
            if block.data <= address < block.data + block.count:
                pointer = block.address + 2 * (address - block.data)
                target = int.from_bytes(self._memory[pointer : pointer + 2], "little")
                return target if target < self.model.size_bytes else address
        return address


@cache
def _registers(model: ServoModel) -> tuple[Register, ...]:
    indirect = [
        model.register(f"indirect_{kind}_{block.first + k}")
        for block in model.indirect
        for kind in ("address", "data")
        for k in range(block.count)
    ]
    return (*model.registers.values(), *indirect)


@cache
def _named(model: ServoModel) -> tuple[dict[str, Register], dict[str, Cell]]:
    registers = {register.name: register for register in _registers(model)}
    return registers, {name: Cell(register) for name, register in registers.items()}


@cache
def _owners(model: ServoModel) -> tuple[Register | None, ...]:
    owners: list[Register | None] = [None] * model.size_bytes
    for register in _registers(model):
        owners[register.address : register.address + register.size] = [register] * register.size
    return tuple(owners)
