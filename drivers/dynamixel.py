"""The servo bus: a Dynamixel driver on the real SDK whose readings are stamped and whose errors say what to do."""
# pyright: reportMissingTypeStubs=false, reportUnknownVariableType=false

from __future__ import annotations

import operator
import threading
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from types import TracebackType
from typing import SupportsIndex, TypeVar

from dynamixel_sdk import COMM_RX_TIMEOUT, COMM_SUCCESS

from drivers.clock import Clock
from drivers.errors import BusLost, CorruptReply, DriverError, NoReply, ServoFault
from drivers.sdk_fence import BITS_PER_BYTE, FencedPort, Status, make_handler
from drivers.servo_models import Register, ServoModel, model_by_number

T = TypeVar("T")
ATTEMPTS = 3  # of every exchange
_MAX_PACKET_BYTES = 250  # TXPACKET_MAX_LEN of the SDK in protocol 1.0; it allows 1024 in 2.0, more than some servos do
_INSTRUCTION_PING = 1
_BROADCAST_BYTES = {1.0: 8, 2.0: 14}  # a sync write without its data
# Model number and the byte after it: three bytes, a size that no register has, so that the reply can be told.
_MARKER_ADDRESS, _MARKER_BYTES = 0, 3

# Protocol 1.0, error byte (e-manual 1.0, Error): these bits are about the instruction, the others about the servo.
_REFUSALS_1 = {2: "angle limit", 8: "range", 64: "instruction"}
_CHECKSUM_1 = 16
# Protocol 2.0, error number (e-manual 2.0, Error); bit 7 is the alert.
_REFUSALS_2 = {
    1: "result fail",
    2: "instruction",
    4: "data range",
    5: "data length",
    6: "data limit (the value is outside the servo's own limits)",
    7: "access (read-only, or EEPROM while torque is on)",
}
_CRC_2, _ALERT_2 = 3, 0x80


@dataclass(frozen=True, slots=True)
class Reading:
    """A register's value and when it was asked for and received, on the bus's clock."""

    value: int
    t_request_ns: int
    t_reply_ns: int

    @property
    def t_ns(self) -> int:
        """Midpoint of request and reply."""
        return (self.t_request_ns + self.t_reply_ns) // 2


class DynamixelBus:
    """A serial port with servos of one protocol on it; safe to use from several threads, one exchange at a time.

    Registers go by their names in the servo's model, which is learned from the model number. Exchanges that fail are
    tried three times and counted in `errors`. An alarm of a servo (overload, overheating...) doesn't make a reading
    wrong: it raises nothing here, `alarms` holds it.

    Args:
        port: path of the device.
        baud: of the servos.
        protocol: 1.0 or 2.0.
        clock: gives the stamps.
        reply_timeout_s: how long to wait for a reply, in real time; the wire time and 34 ms if None.

    Attributes:
        errors: counts of "timeouts", "corrupt" and "unexpected" replies, "retries", "fallbacks" (group reads finished
            one by one) and "stale_bytes".
        alarms: names of the alarm bits that each servo sent last; "alert" where the servo sends but one bit for all.
    """

    def __init__(
        self, port: str, *, baud: int, protocol: float, clock: Clock, reply_timeout_s: float | None = None
    ) -> None:
        if protocol not in (1.0, 2.0):  # the SDK takes any other number for 2.0
            raise DriverError(f"{port}: no protocol {protocol:g}; have 1.0 and 2.0")
        self.path, self.baud, self.protocol = port, baud, protocol
        self._clock = clock
        self._port = FencedPort(port, baud, reply_timeout_s)
        self._handler = make_handler(protocol)
        self._lock = threading.RLock()
        self._models: dict[int, ServoModel] = {}
        self._labels: dict[int, str] = {}
        self._unsettled: set[int] = set()  # servos of which a late reply may yet come
        self._busy_until_ns: int | None = None
        self._counts = dict.fromkeys(("timeouts", "corrupt", "unexpected", "retries", "fallbacks"), 0)
        self.alarms: dict[int, tuple[str, ...]] = {}

    def open(self) -> None:
        """Open the port for this process alone; raises NoPort that says why it can't be."""
        with self._lock:
            if not self._port.is_open:
                self._port.openPort()

    def close(self) -> None:
        """Close the port; nothing happens if it is closed."""
        with self._lock:
            self._port.closePort()

    def __enter__(self) -> DynamixelBus:
        self.open()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    @property
    def errors(self) -> dict[str, int]:
        """Counts of what went wrong and was mended."""
        return {**self._counts, "stale_bytes": self._port.stale_bytes}

    def label(self, servo_id: int, joint: str) -> None:
        """Name the joint that a servo belongs to, for the messages."""
        self._labels[servo_id] = joint

    def describe(self, servo_id: int) -> str:
        """A servo in a message: "servo 3 (elbow)"."""
        joint = self._labels.get(servo_id)
        return f"servo {servo_id}" + (f" ({joint})" if joint else "")

    @property
    def where(self) -> str:
        """The port in a message."""
        return f"{self.path} at {self.baud} baud, protocol {self.protocol:.1f}"

    def ping(self, servo_id: SupportsIndex) -> int:
        """The model number of a servo; raises NoReply if there is none."""
        servo_id = operator.index(servo_id)
        size = 0 if self.protocol == 1.0 else 3  # protocol 2.0: model number and firmware version

        def send() -> int:
            # HEADERS, ID, LENGTH, INSTRUCTION, CHECKSUM: the SDK fills in headers and checksum
            if self.protocol == 1.0:
                return self._handler.txPacket(self._port, [0, 0, servo_id, 2, _INSTRUCTION_PING, 0])
            return self._handler.txPacket(self._port, [0, 0, 0, 0, servo_id, 3, 0, _INSTRUCTION_PING, 0, 0])

        with self._lock:
            status = self._retry(servo_id, lambda: self._exchange(servo_id, send, size))
            data = status.parameters[:2] if size else self._read(servo_id, 0, 2).parameters
            number = int.from_bytes(data, "little")
            if (model := model_by_number(number)) is not None:
                self._models[servo_id] = model
        return number

    def model(self, servo_id: int) -> ServoModel:
        """The model of a servo, asked for once; raises DriverError for one whose control table isn't here."""
        if servo_id not in self._models:
            number = self.ping(servo_id)
            if servo_id not in self._models:
                raise DriverError(
                    f"{self.describe(servo_id)} on {self.where} is of a model (number {number}) whose control table "
                    "isn't known; add it to drivers/servo_models"
                )
        return self._models[servo_id]

    def read(self, servo_id: SupportsIndex, register: str) -> int:
        """The value of a register, signed where the register is."""
        servo_id = operator.index(servo_id)
        at = self.model(servo_id).register(register)
        with self._lock:
            return at.decode(self._read(servo_id, at.address, at.size).parameters)

    def write(self, servo_id: SupportsIndex, register: str, value: SupportsIndex) -> None:
        """Write a register and wait for the servo to confirm; raises ServoFault if it refuses."""
        servo_id = operator.index(servo_id)
        at = self.model(servo_id).register(register)
        data = list(at.encode(operator.index(value)))

        def send() -> int:
            return self._handler.writeTxOnly(self._port, servo_id, at.address, at.size, data)

        with self._lock:
            doing = f"writing {operator.index(value)} to '{register}'"
            self._retry(servo_id, lambda: self._check(self._exchange(servo_id, send, 0), doing))

    def sync_write(self, register: str, values: Mapping[int, SupportsIndex]) -> int:
        """Write a register of several servos at once; no servo confirms it. The stamp (ns) is of the sending."""
        groups: dict[tuple[int, int], list[list[int]]] = {}
        for servo_id, value in values.items():
            at = self.model(servo_id).register(register)
            row = [operator.index(servo_id), *at.encode(operator.index(value))]
            groups.setdefault((at.address, at.size), []).append(row)
        with self._lock:
            t_ns = self._now_ns()
            for (address, size), rows in groups.items():
                most = (_MAX_PACKET_BYTES - _BROADCAST_BYTES[self.protocol]) // (size + 1)
                for start in range(0, len(rows), most):
                    self._send_sync_write(address, size, rows[start : start + most])
        return t_ns

    def read_many(self, servo_ids: Iterable[int], register: str) -> dict[int, Reading]:
        """A register of several servos: by sync read where they have it (protocol 2.0), else one after the other."""
        groups: dict[tuple[int, int], list[int]] = {}
        for servo_id in servo_ids:
            at = self.model(servo_id).register(register)
            groups.setdefault((at.address, at.size), []).append(servo_id)
        readings: dict[int, Reading] = {}
        with self._lock:
            for (address, size), group in groups.items():
                if self.protocol == 2.0 and len(group) > 1:
                    readings |= self._sync_read(group, address, size, register)
                for servo_id in group:
                    if servo_id not in readings:
                        readings[servo_id] = self._read_stamped(servo_id, self.model(servo_id).register(register))
        return readings

    def _send_sync_write(self, address: int, size: int, rows: Sequence[Sequence[int]]) -> None:
        data = [byte for row in rows for byte in row]
        start_ns = self._now_ns()
        self._transmit(lambda: self._handler.syncWriteTxOnly(self._port, address, size, data, len(data)))
        # The line is busy for as long as the bytes take: the next request can't be on it before.
        wire_bytes = len(data) + _BROADCAST_BYTES[self.protocol]
        self._busy_until_ns = start_ns + wire_bytes * BITS_PER_BYTE * 1_000_000_000 // self.baud

    def _now_ns(self) -> int:
        now_ns = self._clock.now_ns()
        return now_ns if self._busy_until_ns is None else max(now_ns, self._busy_until_ns)

    def _read_stamped(self, servo_id: int, register: Register) -> Reading:
        def attempt() -> Reading:
            t_request_ns = self._now_ns()
            data = self._read_once(servo_id, register.address, register.size).parameters
            return Reading(register.decode(data), t_request_ns, self._clock.now_ns())

        return self._retry(servo_id, attempt)

    def _read(self, servo_id: int, address: int, size: int) -> Status:
        return self._retry(servo_id, lambda: self._read_once(servo_id, address, size))

    def _read_once(self, servo_id: int, address: int, size: int) -> Status:
        status = self._exchange(servo_id, lambda: self._handler.readTx(self._port, servo_id, address, size), size)
        self._check(status, f"reading {size} B at {address}")
        if len(status.parameters) != size:
            raise CorruptReply(f"{self.describe(servo_id)} on {self.where} sent no data", servo_id=servo_id)
        return status

    def _sync_read(self, servo_ids: Sequence[int], address: int, size: int, register: str) -> dict[int, Reading]:
        """What a sync read brings; after a servo that is silent the others are too, the caller asks them one by one."""
        for servo_id in servo_ids:
            if servo_id in self._unsettled:
                self._retry(servo_id, lambda: None)  # settles it first
        t_request_ns = self._now_ns()
        statuses: dict[int, Status] = {}
        count = len(servo_ids)
        try:
            self._transmit(lambda: self._handler.syncReadTx(self._port, address, size, list(servo_ids), count, False))
            for servo_id in servo_ids:
                status = self._await(servo_id, size)
                self._check(status, f"reading '{register}'")
                statuses[servo_id] = status
        except (NoReply, CorruptReply):
            self._unsettled |= set(servo_ids) - set(statuses)
            self._counts["fallbacks"] += 1
        t_reply_ns = self._clock.now_ns()
        readings: dict[int, Reading] = {}
        for servo_id, status in statuses.items():
            value = self.model(servo_id).register(register).decode(status.parameters)
            readings[servo_id] = Reading(value, t_request_ns, t_reply_ns)
        return readings

    def _retry(self, servo_id: int, attempt: Callable[[], T]) -> T:
        """Do an exchange, at most three times."""
        for left in reversed(range(ATTEMPTS)):
            try:
                if servo_id in self._unsettled:
                    self._settle(servo_id)
                return attempt()
            except (NoReply, CorruptReply):
                self._unsettled.add(servo_id)
                if not left:
                    raise
                self._counts["retries"] += 1
        raise AssertionError("unreachable")

    def _settle(self, servo_id: int) -> None:
        """Wait until no late reply can come: a servo answers in order, and nothing else has the marker's size."""
        self._exchange(
            servo_id,
            lambda: self._handler.readTx(self._port, servo_id, _MARKER_ADDRESS, _MARKER_BYTES),
            _MARKER_BYTES,
        )
        self._unsettled.discard(servo_id)

    def _exchange(self, servo_id: int, send: Callable[[], int], size: int) -> Status:
        """Send an instruction, return the status packet with `size` bytes of data, or with an error."""
        overhead = 6 if self.protocol == 1.0 else 11  # of a status packet without data
        self._transmit(send)
        self._port.setPacketTimeout(size + overhead)
        return self._await(servo_id, size)

    def _transmit(self, send: Callable[[], int]) -> None:
        if not self._port.is_open:
            raise BusLost(f"{self.path} isn't open; call open() first")
        try:
            result = send()
        except BusLost:
            self._port.closePort()
            raise
        finally:
            self._port.is_using = False  # the SDK leaves it set after any exception: every later call would be refused
        if result != COMM_SUCCESS:
            raise DriverError(f"{self.where}: the SDK refused to send (code {result})")

    def _await(self, servo_id: int, size: int) -> Status:
        """The status packet of this servo and size; those of others, and late ones, are passed over."""
        while True:
            try:
                status, result = self._handler.receive(self._port)
            except BusLost:
                self._port.closePort()
                raise
            finally:
                self._port.is_using = False
            if result == COMM_SUCCESS:
                if status.servo_id == servo_id and self._expected(status, size):
                    self._note_alarm(status)
                    return status
                self._counts["unexpected"] += 1
                continue
            if result == COMM_RX_TIMEOUT:
                self._counts["timeouts"] += 1
                raise NoReply(
                    f"no reply from {self.describe(servo_id)} on {self.where}; "
                    "check power and cable, baud and id in rig.toml",
                    servo_id=servo_id,
                )
            self._counts["corrupt"] += 1
            raise CorruptReply(
                f"the reply of {self.describe(servo_id)} on {self.where} was damaged; "
                "check the cable, and that no two servos have this id",
                servo_id=servo_id,
            )

    def _expected(self, status: Status, size: int) -> bool:
        if len(status.parameters) == size:
            return True
        refused = status.error & (_CHECKSUM_1 | sum(_REFUSALS_1) if self.protocol == 1.0 else ~_ALERT_2)
        return bool(refused) and not status.parameters

    def _note_alarm(self, status: Status) -> None:
        if self.protocol == 1.0:
            bits = status.error & ~(_CHECKSUM_1 | sum(_REFUSALS_1))
            model = self._models.get(status.servo_id)
            names = model.error_names(bits) if model else tuple(f"bit {bit}" for bit in range(8) if bits >> bit & 1)
        else:
            names = ("alert",) if status.error & _ALERT_2 else ()
        if names:
            self.alarms[status.servo_id] = names
        else:
            self.alarms.pop(status.servo_id, None)

    def _check(self, status: Status, doing: str) -> None:
        """Raise what the error number says: CorruptReply for an instruction damaged on the way, ServoFault else."""
        servo = self.describe(status.servo_id)
        damaged = status.error & _CHECKSUM_1 if self.protocol == 1.0 else status.error & ~_ALERT_2 == _CRC_2
        if damaged:
            self._counts["corrupt"] += 1
            raise CorruptReply(f"{servo} on {self.where} got a damaged instruction", servo_id=status.servo_id)
        if self.protocol == 1.0:
            flags = tuple(name for bit, name in _REFUSALS_1.items() if status.error & bit)
        else:
            number = status.error & ~_ALERT_2
            flags = (_REFUSALS_2.get(number, f"error {number}"),) if number else ()
        if flags:
            text = f"{servo} on {self.where} refused {doing}: {', '.join(flags)}"
            raise ServoFault(f"{text}; check the value and the servo's limits", servo_id=status.servo_id, flags=flags)
