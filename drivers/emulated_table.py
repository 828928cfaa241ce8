"""The memory of an emulated servo: registers, what a read or write of bytes means, and what the table alone refuses."""

from __future__ import annotations

from collections.abc import Sequence
from enum import Enum
from functools import cache

from drivers.servo_models import Register, ServoModel


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


class Table:
    """The control table of one servo, as bytes."""

    def __init__(self, model: ServoModel) -> None:
        self.model = model
        self.registers = {register.name: register for register in _registers(model)}
        self._owners = _owners(model)
        self._memory = bytearray(model.size_bytes)

    def __contains__(self, name: str) -> bool:
        return name in self.registers

    def get(self, name: str) -> int:
        """The value of a register."""
        at = self.registers.get(name) or self.model.register(name)
        return at.decode(bytes(self._memory[at.address : at.address + at.size]))

    def set(self, name: str, value: int) -> None:
        """Set a register, whatever its access and range."""
        self.put(self.registers.get(name) or self.model.register(name), value)

    def put(self, register: Register, value: int) -> None:
        """Set a register to the nearest value that its bytes can hold."""
        low, high = register.span
        self._memory[register.address : register.address + register.size] = register.encode(min(max(value, low), high))

    def covers_indirect_data(self, address: int, length: int) -> bool:
        """Whether these bytes hold indirect data, which may stand for any register."""
        return any(address < b.data + b.count and b.data < address + length for b in self.model.indirect)

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

    def power_up(self, keep: Sequence[str] | set[str]) -> None:
        """All registers to their initial values, but for those to keep."""
        for register in self.registers.values():
            if register.name not in keep:
                self.put(register, register.initial or 0)

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
def _owners(model: ServoModel) -> tuple[Register | None, ...]:
    owners: list[Register | None] = [None] * model.size_bytes
    for register in _registers(model):
        owners[register.address : register.address + register.size] = [register] * register.size
    return tuple(owners)
