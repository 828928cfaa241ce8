"""What one emulated servo does when it is told to: instructions and their parameters, in both protocols."""

from __future__ import annotations

from contextlib import suppress

from drivers.emulator.servo import EmulatedServo
from drivers.emulator.table import Refusal, Refused
from drivers.packets import Instruction

# Error byte of the status packet (e-manual, Status Packet, Error).
_ERRORS_1 = {
    Refusal.INSTRUCTION: 64, Refusal.RANGE: 8, Refusal.LENGTH: 8, Refusal.ACCESS: 8, Refusal.LIMIT: 2,
    Refusal.RESULT: 64,
}  # fmt: skip
_ERRORS_2 = {
    Refusal.RESULT: 1, Refusal.INSTRUCTION: 2, Refusal.RANGE: 4, Refusal.LENGTH: 5, Refusal.LIMIT: 6,
    Refusal.ACCESS: 7,
}  # fmt: skip
CHECKSUM_ERROR = {1.0: 16, 2.0: 3}
_ALERT_2 = 0x80
# e-manual, Status Return Level: 0 answers pings alone, 1 reads too, 2 everything.
_ANSWERED_FROM: dict[int, int] = {Instruction.PING: 0, Instruction.READ: 1}
_ANSWERED_FROM_ELSE = 2
# e-manual 2.0, Clear and Control Table Backup: fixed values, so that neither is done by accident.
_CLEAR_TURNS = b"\x01\x44\x58\x4c\x22"
_STORE, _RESTORE = b"\x01\x43\x54\x52\x4c", b"\x02\x43\x54\x52\x4c"
_KEPT = {b"\xff": (), b"\x01": ("id",), b"\x02": ("id", "baud_rate")}  # e-manual 2.0, Factory Reset

# What a secondary id passes on; not verified for other than writes.
_FOLLOWED = {Instruction.WRITE, Instruction.REG_WRITE, Instruction.ACTION, Instruction.REBOOT, Instruction.CLEAR}
# What all do and none answers when it is broadcast; in protocol 2.0 also those of _BROADCAST_2.
_BROADCAST = {Instruction.WRITE, Instruction.REG_WRITE, Instruction.ACTION, Instruction.REBOOT}
_BROADCAST_2 = {Instruction.FACTORY_RESET, Instruction.CLEAR, Instruction.BACKUP}


def answers(servo: EmulatedServo, instruction: int) -> bool:
    """Whether the servo's status return level lets it answer this instruction."""
    return servo.get("status_return_level") >= _ANSWERED_FROM.get(instruction, _ANSWERED_FROM_ELSE)


def attempt(servo: EmulatedServo, instruction: int, parameters: bytes, t_ns: int) -> tuple[int, bytes]:
    """Have a servo do an instruction; its error byte, without its alarms, and the parameters of its answer."""
    try:
        return 0, _execute(servo, instruction, parameters, t_ns, ram_only=False)
    except Refused as refused:
        return (_ERRORS_1 if servo.protocol == 1.0 else _ERRORS_2)[refused.reason], b""


def follow(servo: EmulatedServo, instruction: int, parameters: bytes, t_ns: int) -> None:
    """Have a servo do what its secondary id is told: nothing that changes its EEPROM area (e-manual, Secondary ID)."""
    if instruction in _FOLLOWED:
        with suppress(Refused):
            _execute(servo, instruction, parameters, t_ns, ram_only=True)


def alarm_bits(servo: EmulatedServo) -> int:
    """What the servo's alarms add to its error byte."""
    if servo.protocol == 1.0:
        return servo.alarm
    return _ALERT_2 if servo.alarm else 0


def for_all(instruction: int, parameters: bytes, protocol: float) -> bool:
    """Whether all servos do this when it is broadcast."""
    if protocol == 1.0:  # e-manual 1.0, Factory Reset: not by broadcast
        return instruction in _BROADCAST
    if instruction == Instruction.FACTORY_RESET and parameters == b"\xff":
        return False  # e-manual 2.0, Factory Reset: all servos would have one id
    return instruction in _BROADCAST | _BROADCAST_2


def _execute(servo: EmulatedServo, instruction: int, parameters: bytes, t_ns: int, *, ram_only: bool) -> bytes:
    wide = servo.protocol == 2.0  # addresses and lengths take two bytes
    match instruction:
        case Instruction.PING:
            firmware = servo.get("firmware_version")
            return servo.get("model_number").to_bytes(2, "little") + bytes((firmware,)) if wide else b""
        case Instruction.READ:
            address, length = _numbers(parameters, 2, wide=wide)
            return servo.read(address, length, t_ns)
        case Instruction.WRITE | Instruction.REG_WRITE:
            width = 2 if wide else 1
            (address,) = _numbers(parameters[:width], 1, wide=wide)
            if instruction == Instruction.WRITE:
                servo.write(address, parameters[width:], t_ns, ram_only=ram_only)
            else:
                servo.register_write(address, parameters[width:])
        case Instruction.ACTION:
            servo.action(t_ns)
        case Instruction.FACTORY_RESET:
            servo.factory_reset(t_ns, keep=_kept(parameters) if wide else ())
        # e-manual 1.0, Reboot: MX and X, the models that have Bulk Read too.
        case Instruction.REBOOT if wide or servo.model.bulk_read:
            servo.reboot(t_ns)
        case Instruction.CLEAR if wide:
            _demand(parameters == _CLEAR_TURNS, Refusal.RANGE)
            servo.clear_turns(t_ns)
        case Instruction.BACKUP if wide:
            _demand(parameters in (_STORE, _RESTORE), Refusal.RANGE)
            if parameters == _STORE:
                servo.store_backup()
            else:
                servo.restore_backup(t_ns)
        case _:
            raise Refused(Refusal.INSTRUCTION)
    return b""


def _demand(met: bool, refusal: Refusal) -> None:
    if not met:
        raise Refused(refusal)


def _numbers(parameters: bytes, count: int, *, wide: bool) -> tuple[int, ...]:
    """Addresses and lengths; refused if the parameters are of another size."""
    width = 2 if wide else 1
    _demand(len(parameters) == count * width, Refusal.LENGTH)
    return tuple(int.from_bytes(parameters[at : at + width], "little") for at in range(0, len(parameters), width))


def _kept(parameters: bytes) -> tuple[str, ...]:
    """What a factory reset keeps."""
    _demand(parameters in _KEPT, Refusal.RANGE)
    return _KEPT[parameters]


def group_writes(instruction: int, parameters: bytes, protocol: float) -> list[tuple[int, bytes]]:
    """(id, write parameters) of each servo in a sync or bulk write; none in anything else."""
    if instruction == Instruction.SYNC_WRITE:
        return _sync_write(parameters, wide=protocol == 2.0)
    if instruction == Instruction.BULK_WRITE and protocol == 2.0:
        return _bulk_write(parameters)
    return []


def group_reads(instruction: int, parameters: bytes, protocol: float) -> list[tuple[int, bytes]]:
    """(id, read parameters) of each servo in a sync or bulk read, fast or not; none in anything else."""
    wide = protocol == 2.0
    if instruction in (Instruction.BULK_READ, Instruction.FAST_BULK_READ) and (wide or instruction < 0x9A):
        return _bulk_read(parameters, wide=wide)
    if instruction in (Instruction.SYNC_READ, Instruction.FAST_SYNC_READ) and wide:
        return [(id, parameters[:4]) for id in parameters[4:]]
    return []


def is_fast(instruction: int) -> bool:
    """Whether all servos of a group read share one status packet."""
    return instruction in (Instruction.FAST_SYNC_READ, Instruction.FAST_BULK_READ)


def takes_part(servo: EmulatedServo, instruction: int) -> bool:
    """Whether the servo's model answers this group read, and its status return level lets it."""
    model = servo.model
    # None: depends on the firmware; the emulated one is new
    able = model.fast_sync_read is not False if is_fast(instruction) else model.group_read
    return able and answers(servo, Instruction.READ)


def _sync_write(parameters: bytes, *, wide: bool) -> list[tuple[int, bytes]]:
    """E-manual, Sync Write: address, length, then id and data of each."""
    width = 2 if wide else 1
    address, length = parameters[:width], int.from_bytes(parameters[width : 2 * width], "little")
    data = parameters[2 * width :]
    step = length + 1
    return [(data[at], address + data[at + 1 : at + step]) for at in range(0, len(data) - length, step)]


def _bulk_write(parameters: bytes) -> list[tuple[int, bytes]]:
    """E-manual 2.0, Bulk Write: id, address, length, data of each."""
    writes: list[tuple[int, bytes]] = []
    while len(parameters) > 5:
        end = 5 + int.from_bytes(parameters[3:5], "little")
        writes.append((parameters[0], parameters[1:3] + parameters[5:end]))
        parameters = parameters[end:]
    return writes


def _bulk_read(parameters: bytes, *, wide: bool) -> list[tuple[int, bytes]]:
    """E-manual, Bulk Read: id, address, length of each; protocol 1.0: a zero, then length, id, address of each."""
    if wide:
        return [(parameters[at], parameters[at + 1 : at + 5]) for at in range(0, len(parameters) - 4, 5)]
    rows = [parameters[at : at + 3] for at in range(1, len(parameters) - 2, 3)]
    return [(row[1], bytes((row[2], row[0]))) for row in rows]
