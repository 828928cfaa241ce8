"""When which fault of an emulated bus befalls whom, drawn from a seed: the same faults in every run."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from drivers.emulator.faults import NOISE_BYTES, REPLY_KINDS, STATE_KINDS, Fault, format_fault, format_value
from drivers.errors import DriverError
from drivers.packets import MAX_ID, encode_status
from drivers.servo_models import ServoModel

NS_PER_S = 1_000_000_000
_BITS_PER_BYTE = 10  # a start bit, eight of data from the lowest up, a stop bit


@dataclass(frozen=True, slots=True)
class Change:
    """The begin or the end of a fault that lasts.

    Attributes:
        t_ns: when, on the bus's clock.
        servo_ids: whom it befalls.
        number: the fault's place in the list, by which its end finds its begin.
    """

    t_ns: int
    fault: Fault
    servo_ids: tuple[int, ...]
    number: int
    begins: bool


class FaultSchedule:
    """The faults of one bus over time.

    Each fault draws from a generator of its own, so that one more fault doesn't change what the others do.

    Args:
        faults: raises DriverError for one that can't happen to these servos.
        models: of the servos, by their id.
        seed: of everything random.
        start_ns: the time that the faults count from.
    """

    def __init__(self, faults: Sequence[Fault], models: Mapping[int, ServoModel], *, seed: int, start_ns: int) -> None:
        self._models = dict(models)
        self._start_ns = start_ns
        self._draws = [np.random.default_rng([seed, number]) for number in range(len(faults))]
        befallen = [_befallen(fault, models) for fault in faults]
        self._replies = [
            (fault, frozenset(ids), draw)
            for fault, ids, draw in zip(faults, befallen, self._draws, strict=True)
            if fault.kind in REPLY_KINDS
        ]
        changes = (
            self._changes(number, fault, ids, draw)
            for number, (fault, ids, draw) in enumerate(zip(faults, befallen, self._draws, strict=True))
            if fault.kind in STATE_KINDS and (fault.rate == 1 or draw.random() < fault.rate)
        )
        self._pending = sorted((change for some in changes for change in some), key=lambda change: change.t_ns)

    def next_ns(self) -> int | None:
        """When the next change is due, None if there is none to come."""
        return self._pending[0].t_ns if self._pending else None

    def take_due(self, t_ns: int) -> list[Change]:
        """The changes up to a time, in their order; each is given once."""
        due = [change for change in self._pending if change.t_ns <= t_ns]
        self._pending = self._pending[len(due) :]
        return due

    def mutes(self, servo_id: int, t_ns: int) -> bool:
        """Whether the servo keeps silent."""
        return any(True for _ in self._strikes("mute", (servo_id,), t_ns))

    def sender_id(self, servo_id: int, t_ns: int) -> int:
        """The id that the servo's reply bears."""
        for _, draw in self._strikes("wrong_id", (servo_id,), t_ns):
            servo_id = _other(servo_id, MAX_ID, draw)
        return servo_id

    def delay_ns(self, servo_ids: Collection[int], t_ns: int) -> int:
        """How much later than due a reply of these servos comes."""
        delays = (fault.value for fault, _ in self._strikes("delay", servo_ids, t_ns))
        return sum(round(delay * NS_PER_S) for delay in delays if isinstance(delay, float | int))

    def spoil(
        self, reply: bytes, servo_ids: Collection[int], t_ns: int, *, protocol: float, instruction: bytes
    ) -> bytes:
        """What is on the wire in place of a reply.

        Args:
            reply: a status packet.
            servo_ids: whose it is; a fast read has several.
            instruction: the packet that it answers; empty if it isn't the first answer.
        """
        for _, draw in self._strikes("bad_crc", servo_ids, t_ns):
            reply = _changed(reply, len(reply) - int(draw.integers(1, 2 if protocol == 1.0 else 3)), draw)
        for _, draw in self._strikes("corrupt", servo_ids, t_ns):
            reply = _changed(reply, int(draw.integers(len(reply))), draw)
        for _, draw in self._strikes("duplicate_id", servo_ids, t_ns):
            second = reply[:-3] + draw.bytes(3)  # the same servo_id, other values
            reply = wired_and(reply, second, int(draw.integers(1, _BITS_PER_BYTE)))
        for _, draw in self._strikes("truncate", servo_ids, t_ns):
            reply = reply[: int(draw.integers(1, len(reply)))]
        for fault, draw in self._strikes("noise", servo_ids, t_ns):
            most = int(fault.value) if isinstance(fault.value, float | int) else NOISE_BYTES
            reply = draw.bytes(int(draw.integers(1, most + 1))) + reply
        for _, draw in self._strikes("stray", servo_ids, t_ns):
            reply = self._stray(servo_ids, len(reply), protocol, draw) + reply
        for _ in self._strikes("echo", servo_ids, t_ns):
            reply = instruction + reply
        return reply

    def _strikes(self, kind: str, servo_ids: Collection[int], t_ns: int) -> Iterable[tuple[Fault, np.random.Generator]]:
        """The faults of a kind that befall a reply of these servos at this time."""
        t_s = (t_ns - self._start_ns) / NS_PER_S
        for fault, ids, draw in self._replies:
            if fault.kind != kind or ids.isdisjoint(servo_ids) or not fault.at_s <= t_s < fault.at_s + fault.for_s:
                continue
            if fault.rate == 1 or draw.random() < fault.rate:
                yield fault, draw

    def _stray(self, servo_ids: Collection[int], size: int, protocol: float, draw: np.random.Generator) -> bytes:
        """A valid reply of another servo, as long as the true one."""
        others = sorted(self._models.keys() - set(servo_ids))
        stranger = others[int(draw.integers(len(others)))] if others else _other(min(servo_ids), MAX_ID, draw)
        return encode_status(stranger, 0, draw.bytes(max(0, size - (6 if protocol == 1.0 else 11))), protocol)

    def _changes(self, number: int, fault: Fault, ids: tuple[int, ...], draw: np.random.Generator) -> Iterable[Change]:
        begin_ns = self._start_ns + round(fault.at_s * NS_PER_S)
        yield Change(begin_ns, fault, ids, number, begins=True)
        if fault.for_s != math.inf:
            yield Change(begin_ns + round(fault.for_s * NS_PER_S), fault, ids, number, begins=False)


def wired_and(first: bytes, second: bytes, shift_bits: int) -> bytes:
    """What a client receives of two transmissions at once, the second one `shift_bits` later.

    The line is high at rest, and low as soon as one sender pulls it low. The receiver takes a byte from each falling
    edge on, and doesn't mind a stop bit that is low.
    """
    levels = np.ones(max(len(first), len(second)) * _BITS_PER_BYTE + shift_bits, bool)
    for data, at in ((first, 0), (second, shift_bits)):
        levels[at : at + len(data) * _BITS_PER_BYTE] &= _levels(data)
    received, at = bytearray(), 0
    while at < len(levels):
        if levels[at]:
            at += 1
            continue
        bits = levels[at + 1 : at + 9]
        received.append(int(sum(int(level) << place for place, level in enumerate(bits))))
        at += _BITS_PER_BYTE
    return bytes(received)


def _levels(data: bytes) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    frames = np.ones((len(data), _BITS_PER_BYTE), bool)
    frames[:, 0] = False
    bits = np.unpackbits(np.frombuffer(data, np.uint8), bitorder="little")
    frames[:, 1:9] = bits.reshape(-1, 8).astype(bool)
    return frames.ravel()


def _changed(data: bytes, at: int, draw: np.random.Generator) -> bytes:
    """The same bytes but for one."""
    return data[:at] + bytes((data[at] ^ int(draw.integers(1, 256)),)) + data[at + 1 :]


def _other(value: int, most: int, draw: np.random.Generator) -> int:
    """A number of 0 to `most` that isn't this one."""
    found = int(draw.integers(most))
    return found + (found >= value)


def _befallen(fault: Fault, models: Mapping[int, ServoModel]) -> tuple[int, ...]:
    """Whom a fault can befall; raises DriverError if that is nobody."""
    if fault.servo_ids is None:
        able = tuple(id for id, model in models.items() if _lack(fault, model) is None)
        if able or not models:
            return able
        raise DriverError(f"fault '{format_fault(fault)}': {_lack(fault, next(iter(models.values())))}")
    for id in fault.servo_ids:
        if id not in models:
            have = ", ".join(map(str, models)) or "none"
            raise DriverError(f"fault '{format_fault(fault)}': no servo {id} on this bus; it has {have}")
        if (lack := _lack(fault, models[id])) is not None:
            raise DriverError(f"fault '{format_fault(fault)}': servo {id}: {lack}")
    return fault.servo_ids


def _lack(fault: Fault, model: ServoModel) -> str | None:
    """What a model doesn't have, without which the fault can't befall it."""
    if fault.kind == "alert" and fault.value not in model.error_bits.values():
        return f"{model.name} has no alarm '{fault.value}'; it has {', '.join(model.error_bits.values())}"
    if fault.kind == "baud" and fault.value not in model.baud_codes.values():
        have = ", ".join(map(str, model.baud_codes.values()))
        return f"{model.name} has no baud {format_value(fault.value)}; it has {have}"
    return None
