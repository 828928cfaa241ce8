"""Emulated servos on one wire: from instruction packets to replies with the times at which they come."""

from __future__ import annotations

import threading
from collections.abc import Iterator, Sequence
from functools import reduce
from typing import NamedTuple

from drivers.emulator.fault_changes import FaultChanges
from drivers.emulator.fault_schedule import FaultSchedule, wired_and
from drivers.emulator.faults import Fault
from drivers.emulator.instructions import (
    CHECKSUM_ERROR,
    alarm_bits,
    answers,
    attempt,
    follow,
    for_all,
    group_reads,
    group_writes,
    is_fast,
    takes_part,
)
from drivers.emulator.servo import EmulatedServo
from drivers.errors import DriverError
from drivers.packets import BROADCAST, Frame, Instruction, crc16, encode, encode_status

BITS_PER_BYTE = 10  # e-manual, Protocol: 8 bits, 1 start bit, 1 stop bit, no parity
_SKEW_BITS = 3  # by how much two servos of one id answer one after the other
_MAX_LENGTH = 0xFFFF  # LENGTH has two bytes (e-manual 2.0, Length)
_FAST_HEADER = b"\xff\xff\xfd\x00\xfe"
_STATUS = 0x55


class Sending(NamedTuple):
    """Bytes on their way to the client."""

    due_ns: int  # when the last of them arrives, on the bus's clock
    servo_id: int  # whose they are; of a fast read, the first servo's
    data: bytes


class Wire:
    """Servos of any models, protocols and bauds, and the faults that befall them. It knows no device and no thread.

    How far the wire has got runs ahead of the clock that its user keeps: the time of a reply is told, not waited for.

    Args:
        servos: with distinct ids.
        faults: raises DriverError for one that can't happen to these servos.
        seed: of everything random.
        start_ns: the time that the faults count from.
    """

    def __init__(self, servos: Sequence[EmulatedServo], *, faults: Sequence[Fault], seed: int, start_ns: int) -> None:
        self.servos = tuple(servos)
        if len({servo.id for servo in servos}) != len(servos):
            raise DriverError("two emulated servos have one id; give each its own")
        self.protocols = frozenset(servo.protocol for servo in servos)
        self._faults = FaultSchedule(faults, {servo.id: servo.model for servo in servos}, seed=seed, start_ns=start_ns)
        self._changes = FaultChanges(self.servos)
        self._line_ns = start_ns
        self._echo = b""
        self.lock = threading.RLock()  # over the servos' state

    @property
    def plugged(self) -> bool:
        """Whether no fault keeps the device away."""
        return self._changes.plugged

    def servo(self, servo_id: int) -> EmulatedServo:
        """The servo that has this id now; raises DriverError."""
        for servo in self.servos:
            if servo.id == servo_id:
                return servo
        raise DriverError(f"no emulated servo {servo_id}; have {', '.join(str(servo.id) for servo in self.servos)}")

    def next_change_ns(self) -> int | None:
        """When the next fault begins or ends that isn't one of a reply."""
        return self._faults.next_ns()

    def advance(self, t_ns: int) -> None:
        """Let the faults begin and end that are due, and the servos live on."""
        with self.lock:
            self.befall(t_ns)
            for servo in self.servos:
                servo.advance(t_ns)

    def befall(self, t_ns: int) -> None:
        """Let the faults begin and end that are due."""
        with self.lock:
            for change in self._faults.take_due(t_ns):
                self._changes.apply(change)

    def hear(self, frame: Frame, protocol: float, baud: int | None, now_ns: int) -> Iterator[Sending]:
        """Let a packet pass over the wire, have it done, and yield the replies.

        Args:
            baud: the client's; servos at another one hear nothing. None if it isn't known: all hear it then.
            now_ns: when the packet began.
        """
        self._line_ns = max(self._line_ns, now_ns)
        self._pass(self._wire_ns(frame.wire_bytes, baud))
        self.advance(self._line_ns)
        listening = [servo for servo in self.servos if servo.protocol == protocol and self._hears(servo, baud)]
        if not self.plugged or not listening:
            return
        if not frame.intact:
            # On a wire of both protocols, a packet of the one can look like the start of one of the other.
            if len(self.protocols) == 1:
                yield from self._complain(frame.servo_id, listening)
            return
        self._echo = encode(frame.servo_id, frame.body, protocol)
        with self.lock:
            for servo in listening:
                servo.hear(self._line_ns)
        instruction, parameters = frame.body[0], frame.body[1:]
        if frame.servo_id == BROADCAST:
            yield from self._broadcast(instruction, parameters, listening, protocol)
        else:
            yield from self._single(frame.servo_id, instruction, parameters, listening)

    def _hears(self, servo: EmulatedServo, baud: int | None) -> bool:
        return self._changes.powered(servo) and (baud is None or servo.baud == baud)

    def _complain(self, servo_id: int, listening: Sequence[EmulatedServo]) -> Iterator[Sending]:
        for servo in listening:
            if servo.id == servo_id:
                yield from self._reply([(servo, CHECKSUM_ERROR[servo.protocol], b"")])

    def _single(
        self, servo_id: int, instruction: int, parameters: bytes, listening: Sequence[EmulatedServo]
    ) -> Iterator[Sending]:
        asked = [servo for servo in listening if servo.id == servo_id]
        # e-manual, Secondary ID: does as it is told, and sends no status packet.
        with self.lock:
            for servo in listening:
                if servo.secondary_id == servo_id and servo not in asked:
                    follow(servo, instruction, parameters, self._line_ns)
        answering = [servo for servo in asked if answers(servo, instruction)]  # as it was before the instruction
        read = instruction == Instruction.READ
        if read and answering:
            self._pass(answering[0].return_delay_ns)  # the answer is of the moment at which it is sent
        found = [(servo, *self._attempt(servo, instruction, parameters)) for servo in asked]
        if answering:
            yield from self._reply([answer for answer in found if answer[0] in answering], delay=not read)

    def _broadcast(
        self, instruction: int, parameters: bytes, listening: Sequence[EmulatedServo], protocol: float
    ) -> Iterator[Sending]:
        if instruction == Instruction.PING and protocol == 2.0:
            for servo in sorted(listening, key=lambda servo: servo.id):
                yield from self._reply([(servo, *self._attempt(servo, instruction, parameters))])
        elif for_all(instruction, parameters, protocol):
            for servo in listening:
                self._attempt(servo, instruction, parameters)
        elif writes := group_writes(instruction, parameters, protocol):
            for id, request in writes:
                self._write(id, request, listening)
        elif reads := group_reads(instruction, parameters, protocol):
            by_id = {servo.id: servo for servo in listening if takes_part(servo, instruction)}
            yield from (self._fast_read if is_fast(instruction) else self._group_read)(reads, by_id)
        # anything else is silence

    def _write(self, servo_id: int, request: bytes, listening: Sequence[EmulatedServo]) -> None:
        with self.lock:
            for servo in listening:
                if servo.id == servo_id:
                    attempt(servo, Instruction.WRITE, request, self._line_ns)
                elif servo.secondary_id == servo_id:
                    follow(servo, Instruction.WRITE, request, self._line_ns)

    def _group_read(self, requests: Sequence[tuple[int, bytes]], servos: dict[int, EmulatedServo]) -> Iterator[Sending]:
        """Answer one after the other: each waits for the one before, so that all fall silent after a missing one."""
        for id, request in requests:
            servo = servos.get(id)
            if servo is None or self._faults.mutes(id, self._line_ns):
                return
            self._pass(servo.return_delay_ns)
            yield from self._transmit([(servo, *self._attempt(servo, Instruction.READ, request))])

    def _fast_read(self, requests: Sequence[tuple[int, bytes]], servos: dict[int, EmulatedServo]) -> Iterator[Sending]:
        """Answer in one status packet, which each servo carries on, and which breaks off at a missing one.

        It has no byte stuffing; after each part comes the checksum of all before (e-manual 2.0, Fast Sync Read). Not
        verified: that only the first one's return delay counts, and that a servo that refuses to read sends zeros.
        """
        lengths = [int.from_bytes(request[2:4], "little") for _, request in requests]
        total = 1 + sum(length + 4 for length in lengths)
        if total > _MAX_LENGTH:
            return  # no packet can be so long: nothing is sent; not verified
        packet = _FAST_HEADER + total.to_bytes(2, "little") + bytes((_STATUS,))
        senders: list[EmulatedServo] = []
        for (id, request), length in zip(requests, lengths, strict=True):
            servo = servos.get(id)
            if servo is None or self._faults.mutes(id, self._line_ns):
                break
            if not senders:
                self._pass(servo.return_delay_ns)
            error, data = self._attempt(servo, Instruction.READ, request)
            sender_id = self._faults.sender_id(id, self._line_ns)
            packet += bytes((error | alarm_bits(servo), sender_id)) + data.ljust(length, b"\0")
            packet += crc16(packet).to_bytes(2, "little")
            senders.append(servo)
        if senders:
            yield from self._send(packet, senders)

    def _attempt(self, servo: EmulatedServo, instruction: int, parameters: bytes) -> tuple[int, bytes]:
        with self.lock:
            return attempt(servo, instruction, parameters, self._line_ns)

    def _reply(self, found: Sequence[tuple[EmulatedServo, int, bytes]], *, delay: bool = True) -> Iterator[Sending]:
        """The answers, which are several where servos share an id, after the return delay unless that has passed."""
        if delay and found:
            self._pass(found[0][0].return_delay_ns)
        found = [answer for answer in found if not self._faults.mutes(answer[0].id, self._line_ns)]
        if found:
            yield from self._transmit(found)

    def _transmit(self, found: Sequence[tuple[EmulatedServo, int, bytes]]) -> Iterator[Sending]:
        packets = [
            encode_status(
                self._faults.sender_id(servo.id, self._line_ns), error | alarm_bits(servo), data, servo.protocol
            )
            for servo, error, data in found
        ]
        packet = reduce(lambda first, second: wired_and(first, second, _SKEW_BITS), packets)
        yield from self._send(packet, [servo for servo, _, _ in found])

    def _send(self, packet: bytes, senders: Sequence[EmulatedServo]) -> Iterator[Sending]:
        """Put a packet on the wire as the faults leave it."""
        ids, sender = [servo.id for servo in senders], senders[0]
        wire_ns = self._wire_ns(len(packet), sender.baud)
        packet = self._faults.spoil(packet, ids, self._line_ns, protocol=sender.protocol, instruction=self._echo)
        self._echo = b""
        self._pass(self._faults.delay_ns(ids, self._line_ns) + wire_ns)
        self.advance(self._line_ns)
        if self.plugged:
            yield Sending(self._line_ns, sender.id, packet)

    def _wire_ns(self, count: int, baud: int | None) -> int:
        baud = baud or next((servo.baud for servo in self.servos if servo.baud), 0)
        return count * BITS_PER_BYTE * 1_000_000_000 // baud if baud else 0

    def _pass(self, duration_ns: int) -> None:
        self._line_ns += duration_ns
