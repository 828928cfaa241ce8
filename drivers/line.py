"""Questions and answers on one serial line, one at a time: retries, stale and foreign replies, reads of a group.

Servos are ids here and registers are addresses; names are `drivers.dynamixel`'s.
"""
# pyright: reportMissingTypeStubs=false, reportUnknownVariableType=false

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeVar

from dynamixel_sdk import COMM_RX_TIMEOUT, COMM_SUCCESS

from drivers.clock import Clock
from drivers.errors import BusLost, CorruptReply, DriverError, NoReply, ServoFault
from drivers.sdk_fence import BITS_PER_BYTE, FencedPort, Status, make_handler
from drivers.status_errors import alarm_bits, damaged, refusals

T = TypeVar("T")
ATTEMPTS = 3  # of every exchange
_MAX_PACKET_BYTES = 250  # TXPACKET_MAX_LEN of the SDK in protocol 1.0; it allows 1024 in 2.0, more than some servos do
_INSTRUCTION_PING, _INSTRUCTION_REBOOT = 0x01, 0x08
_BROADCAST_BYTES = {1.0: 8, 2.0: 14}  # a sync write without its data
_STATUS_BYTES = {1.0: 6, 2.0: 11}  # a status packet without data
# Reads from address 0 of sizes that nothing else asks for, so that their replies can be told; used in turn, so that the
# reply to one that came too late isn't taken for the next one's.
MARKER_BYTES = (5, 7, 9, 13)
_LONGEST_DELAY_NS = 508_000  # e-manual, Return Delay Time: 254 units of 2 us
# ms. After a group read that went wrong: the pause after which nobody is answering it any more, beside the wire time.
_QUIET_MS = 5.0


@dataclass(frozen=True, slots=True)
class Answer:
    """Bytes of a control table, and when they were asked for and received."""

    data: bytes
    t_request_ns: int
    t_reply_ns: int


class Line:
    """One port in one protocol; not safe to use from several threads.

    Args:
        labels: name of the joint of each servo, for the messages; may grow later.

    Attributes:
        counts: what went wrong and was mended.
        alarms: alarm bits of the last status packet of each servo that had any.
    """

    def __init__(self, port: FencedPort, protocol: float, clock: Clock, *, labels: Mapping[int, str]) -> None:
        self.where = f"{port.path} at {port.baudrate} baud, protocol {protocol:.1f}"
        self.counts = dict.fromkeys(("timeouts", "corrupt", "unexpected", "echoes", "retries", "fallbacks"), 0)
        self.alarms: dict[int, int] = {}
        self._port, self._protocol, self._clock = port, protocol, clock
        self._labels = labels
        self._handler = make_handler(protocol)
        # Failures so far, and how many there had been when each servo last had nothing more to say. A late reply may be
        # under another's id: after a failure all servos are in doubt.
        self._failures = 0
        self._settled_at: dict[int, int] = {}
        self._markers = itertools.cycle(MARKER_BYTES)
        self._busy_until_ns: int | None = None

    def describe(self, servo_id: int) -> str:
        """A servo in a message: "servo 3 (elbow)"."""
        joint = self._labels.get(servo_id)
        return f"servo {servo_id}" + (f" ({joint})" if joint else "")

    def ping(self, servo_id: int) -> int:
        """The model number of a servo."""
        size = 0 if self._protocol == 1.0 else 3  # protocol 2.0: model number and firmware version

        def ask() -> Status:
            return self._exchange(servo_id, lambda: self._send_plain(servo_id, _INSTRUCTION_PING), size, ping=True)

        status = self._retry(servo_id, ask, settle=False)  # a servo may answer pings alone
        data = status.parameters[:2] if size else self.read(servo_id, 0, 2).data
        return int.from_bytes(data, "little")

    def reboot(self, servo_id: int) -> None:
        """Restart a servo (protocol 2.0)."""
        self._retry(
            servo_id,
            lambda: self._check(
                self._exchange(servo_id, lambda: self._send_plain(servo_id, _INSTRUCTION_REBOOT), 0), "a reboot"
            ),
        )

    def read(self, servo_id: int, address: int, size: int) -> Answer:
        """Bytes of one servo's control table."""
        return self._retry(servo_id, lambda: self._read_once(servo_id, address, size))

    def write(self, servo_id: int, address: int, data: bytes, doing: str) -> None:
        """Write bytes and wait for the servo to confirm; raises ServoFault, which says what it was `doing`, if not."""

        def send() -> int:
            return self._handler.writeTxOnly(self._port, servo_id, address, len(data), list(data))

        self._retry(servo_id, lambda: self._check(self._exchange(servo_id, send, 0), doing))

    def sync_write(self, address: int, size: int, rows: Sequence[Sequence[int]]) -> int:
        """Write [id, bytes...] of several servos at once, which nobody confirms; returns the stamp of the sending."""
        t_ns = self._now_ns()
        most = (_MAX_PACKET_BYTES - _BROADCAST_BYTES[self._protocol]) // (size + 1)
        for start in range(0, len(rows), most):
            self._send_sync_write(address, size, [byte for row in rows[start : start + most] for byte in row])
        return t_ns

    def sync_read(self, servo_ids: Sequence[int], address: int, size: int) -> dict[int, Answer]:
        """The same bytes of several servos by one instruction (protocol 2.0); empty if one reply is amiss."""
        count = len(servo_ids)

        def send() -> int:
            return self._handler.syncReadTx(self._port, address, size, list(servo_ids), count, False)

        return self._group_read(servo_ids, size, send)

    def bulk_read(self, servo_ids: Sequence[int], address: int, size: int) -> dict[int, Answer]:
        """As `sync_read`, by protocol 1.0's bulk read; of the SDK only the packet handler's works."""
        rows = [byte for servo_id in servo_ids for byte in (size, servo_id, address)]
        return self._group_read(servo_ids, size, lambda: self._handler.bulkReadTx(self._port, rows, len(rows)))

    def _send_plain(self, servo_id: int, instruction: int) -> int:
        # HEADERS, ID, LENGTH, INSTRUCTION, CHECKSUM: the SDK fills in headers and checksum
        if self._protocol == 1.0:
            return self._handler.txPacket(self._port, [0, 0, servo_id, 2, instruction, 0])
        return self._handler.txPacket(self._port, [0, 0, 0, 0, servo_id, 3, 0, instruction, 0, 0])

    def _send_sync_write(self, address: int, size: int, data: Sequence[int]) -> None:
        start_ns = self._now_ns()
        self._transmit(lambda: self._handler.syncWriteTxOnly(self._port, address, size, list(data), len(data)))
        # The line is busy for as long as the bytes take: the next request can't be on it before.
        wire_bytes = len(data) + _BROADCAST_BYTES[self._protocol]
        self._busy_until_ns = start_ns + wire_bytes * BITS_PER_BYTE * 1_000_000_000 // self._port.baudrate

    def _now_ns(self) -> int:
        now_ns = self._clock.now_ns()
        return now_ns if self._busy_until_ns is None else max(now_ns, self._busy_until_ns)

    def _read_once(self, servo_id: int, address: int, size: int) -> Answer:
        t_request_ns = self._now_ns()
        status = self._exchange(servo_id, lambda: self._handler.readTx(self._port, servo_id, address, size), size)
        t_reply_ns = self._clock.now_ns()
        self._check(status, f"reading {size} B at {address}")
        if len(status.parameters) != size:
            raise self._error(CorruptReply, servo_id, "{servo} on {where} sent no data")
        return Answer(status.parameters, t_request_ns, t_reply_ns)

    def _group_read(self, servo_ids: Sequence[int], size: int, send: Callable[[], int]) -> dict[int, Answer]:
        """All replies, in order, or none: where one is missing, another may stand in its place under its id."""
        for servo_id in servo_ids:
            if self._in_doubt(servo_id):
                self._retry(servo_id, lambda: None)  # settles it first
        t_request_ns = self._now_ns()
        data: dict[int, bytes] = {}
        try:
            self._transmit(send)
            for servo_id in servo_ids:
                status = self._await(servo_id, size, in_turn=True)
                self._check(status, f"a group read of {size} B")
                data[servo_id] = status.parameters
        except (NoReply, CorruptReply):
            self._failures += 1
            self.counts["fallbacks"] += 1
            self._wait_for_quiet(len(servo_ids) * (size + _STATUS_BYTES[self._protocol]))
            return {}
        return self._in_turns(data, t_request_ns, self._clock.now_ns(), size)

    def _in_turns(self, data: Mapping[int, bytes], t_request_ns: int, t_reply_ns: int, size: int) -> dict[int, Answer]:
        """Each servo's share of the time of a group read: they answer one after the other, in turns of equal length.

        Time beyond what the bytes and the longest return delays take is the adapter's: it comes after the last turn.
        """
        byte_ns = BITS_PER_BYTE * 1_000_000_000 // self._port.baudrate
        start_ns = t_request_ns + len(self._port.sent) * byte_ns
        longest_ns = (size + _STATUS_BYTES[self._protocol]) * byte_ns + _LONGEST_DELAY_NS
        turn_ns = max(0, min((t_reply_ns - start_ns) // len(data), longest_ns))
        return {
            servo_id: Answer(found, start_ns + k * turn_ns, start_ns + (k + 1) * turn_ns)
            for k, (servo_id, found) in enumerate(data.items())
        }

    def _wait_for_quiet(self, wire_bytes: int) -> None:
        """Let those who still answer finish: a question now would collide with them."""
        self._port.setPacketTimeoutMillis(1000 * wire_bytes * BITS_PER_BYTE / self._port.baudrate + _QUIET_MS)
        while self._receive()[1] != COMM_RX_TIMEOUT:
            pass

    def _retry(self, servo_id: int, attempt: Callable[[], T], *, settle: bool = True) -> T:
        """Do an exchange, as often as is allowed."""
        for left in reversed(range(ATTEMPTS)):
            try:
                if settle and self._in_doubt(servo_id):
                    self._settle(servo_id)
                return attempt()
            except (NoReply, CorruptReply):
                self._failures += 1
                if not left:
                    raise
                self.counts["retries"] += 1
        raise AssertionError("unreachable")

    def _in_doubt(self, servo_id: int) -> bool:
        """Whether a late reply may come that this servo sent, or that says so."""
        return self._settled_at.get(servo_id, 0) < self._failures

    def _settle(self, servo_id: int) -> None:
        """Wait until no late reply can come: the line keeps its order, and nothing else has the marker's size."""
        size = next(self._markers)
        self._exchange(servo_id, lambda: self._handler.readTx(self._port, servo_id, 0, size), size)
        self._settled_at[servo_id] = self._failures

    def _exchange(self, servo_id: int, send: Callable[[], int], size: int, *, ping: bool = False) -> Status:
        """Send an instruction, return the status packet with `size` bytes of data, or with an error."""
        self._transmit(send)
        self._port.setPacketTimeout(size + _STATUS_BYTES[self._protocol])
        return self._await(servo_id, size, ping=ping)

    def _transmit(self, send: Callable[[], int]) -> None:
        if not self._port.is_open:
            raise BusLost(f"{self._port.path} isn't open; call open() first")
        try:
            result = send()
        except BusLost:
            self._port.closePort()
            raise
        finally:
            self._port.is_using = False  # the SDK leaves it set after any exception: every later call would be refused
        if result != COMM_SUCCESS:
            raise DriverError(f"{self.where}: the SDK refused to send (code {result})")

    def _receive(self) -> tuple[Status | None, int]:
        try:
            return self._handler.receive(self._port)
        except BusLost:
            self._port.closePort()
            raise
        finally:
            self._port.is_using = False

    def _await(self, servo_id: int, size: int, *, in_turn: bool = False, ping: bool = False) -> Status:
        """The status packet of this servo and size; echoes, and packets of others and late ones, are passed over.

        Args:
            in_turn: nothing else may come before it, not even a byte: it may be what is left of the true reply.
            ping: in protocol 1.0 an alarm of the voltage answers a ping with the very bytes of the ping: what looks
                like an echo counts then if nothing else comes.
        """
        twin: Status | None = None
        while True:
            status, result = self._receive()
            if result == COMM_SUCCESS and status is not None:
                fits = status.servo_id == servo_id and self._expected(status, size) and (status.alone or not in_turn)
                if fits and not status.echo:
                    return self._noted(status)
                self.counts["echoes" if status.echo else "unexpected"] += 1
                if in_turn:
                    raise self._error(
                        CorruptReply, servo_id, "another reply came in place of that of {servo} on {where}"
                    )
                twin = status if fits and ping else twin
            elif result != COMM_RX_TIMEOUT:
                self.counts["corrupt"] += 1
                text = (
                    "the reply of {servo} on {where} was damaged; check the cable, and that no two servos have this id"
                )
                raise self._error(CorruptReply, servo_id, text)
            elif twin is not None:
                return self._noted(twin)
            else:
                self.counts["timeouts"] += 1
                text = "no reply from {servo} on {where}; check power and cable, baud and id in rig.toml"
                raise self._error(NoReply, servo_id, text)

    def _error(self, kind: type[NoReply] | type[CorruptReply], servo_id: int, text: str) -> NoReply | CorruptReply:
        message = text.format(servo=self.describe(servo_id), where=self.where)
        return kind(message, servo_id=servo_id, joint=self._labels.get(servo_id))

    def _expected(self, status: Status, size: int) -> bool:
        if len(status.parameters) == size:
            return True
        error = status.error
        refused = damaged(error, self._protocol) or refusals(error, self._protocol)
        return bool(refused) and not status.parameters

    def _noted(self, status: Status) -> Status:
        if bits := alarm_bits(status.error, self._protocol):
            self.alarms[status.servo_id] = bits
        else:
            self.alarms.pop(status.servo_id, None)
        return status

    def _check(self, status: Status, doing: str) -> None:
        """Raise what the error says: CorruptReply for an instruction damaged on the way, ServoFault for a refusal."""
        servo_id = status.servo_id
        if damaged(status.error, self._protocol):
            self.counts["corrupt"] += 1
            raise self._error(CorruptReply, servo_id, "{servo} on {where} got a damaged instruction")
        if flags := refusals(status.error, self._protocol):
            text = f"{self.describe(servo_id)} on {self.where} refused {doing}: {', '.join(flags)}"
            joint = self._labels.get(servo_id)
            text = f"{text}; check the value and the servo's limits"
            raise ServoFault(text, servo_id=servo_id, joint=joint, flags=flags)
