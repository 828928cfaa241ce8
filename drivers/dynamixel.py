"""The servo bus: a Dynamixel driver on the real SDK whose readings are stamped and whose errors say what to do."""

from __future__ import annotations

import contextlib
import operator
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from types import TracebackType
from typing import SupportsIndex, TypeVar

from drivers.clock import Clock
from drivers.errors import BusLost, DriverError
from drivers.line import MARKER_BYTES, Answer, Line
from drivers.owner import OwnerEnded, OwnerThread
from drivers.sdk_fence import FencedPort
from drivers.servo_models import Register, ServoModel, model_by_number

T = TypeVar("T")
ALERT = "alert"  # protocol 2.0: the status packet says that there is an alarm; which, its register tells


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


@dataclass(frozen=True, slots=True)
class Block:
    """Several registers of one servo, read at once, and when they were asked for and received."""

    values: Mapping[str, int]
    t_request_ns: int
    t_reply_ns: int


class _Layout:
    """Registers within the bytes from the first of them to the last."""

    def __init__(self, registers: Sequence[Register]) -> None:
        self.start = min(register.address for register in registers)
        self.size = max(register.address + register.size for register in registers) - self.start
        if self.size in MARKER_BYTES:  # those the line keeps for itself
            self.start, self.size = max(0, self.start - 1), self.size + 1
        self._parts = [
            (register, slice(register.address - self.start, register.address - self.start + register.size))
            for register in registers
        ]

    def block(self, answer: Answer) -> Block:
        values = {register.name: register.decode(answer.data[part]) for register, part in self._parts}
        return Block(values, answer.t_request_ns, answer.t_reply_ns)


class DynamixelBus:
    """A serial port with servos of one protocol on it; safe to use from several threads.

    One thread of its own owns the port: every exchange is done there, whole and in order, whatever happens to the
    thread that asked (a signal while it waits leaves no half-read reply on the line).

    Registers go by their names in the servo's model, which is learned from the model number. Exchanges that fail are
    tried three times and counted in `errors`. An alarm of a servo (overload, overheating...) doesn't make a reading
    wrong: it raises nothing here, `alarms` holds it.

    Args:
        port: path of the device.
        baud: of the servos.
        protocol: 1.0 or 2.0.
        clock: gives the stamps.
        reply_timeout_s: how long to wait for a reply, in real time; the wire time and 34 ms if None.

    Raises (all methods that talk):
        BusLost: the port isn't open, or is lost now; it is closed then, and can be opened again.
        NoReply, CorruptReply: after the last attempt.
        ServoFault: a servo refuses.
    """

    def __init__(
        self,
        port: str,
        *,
        baud: int,
        protocol: float,
        clock: Clock,
        reply_timeout_s: float | None = None,
    ) -> None:
        if protocol not in (1.0, 2.0):  # the SDK takes any other number for 2.0
            raise DriverError(f"{port}: no protocol {protocol:g}; have 1.0 and 2.0")
        self.path, self.baud, self.protocol = port, baud, protocol
        self._port = FencedPort(port, baud, reply_timeout_s)
        self._labels: dict[int, str] = {}
        self._line = Line(self._port, protocol, clock, labels=self._labels)
        self._models: dict[int, ServoModel] = {}
        self._layouts: dict[tuple[int, tuple[str, ...]], _Layout] = {}
        self._owner: OwnerThread | None = None

    def open(self) -> None:
        """Open the port for this program alone; raises NoPort that says why it can't be."""
        if self._owner is not None:
            return
        self._owner = OwnerThread(f"bus {self.path}")
        try:
            self._owned(self._port.openPort)
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Close the port once the exchange under way is done; nothing happens if it is closed."""
        owner, self._owner = self._owner, None
        if owner is not None:
            with contextlib.suppress(OwnerEnded):  # another thread was as quick
                owner.do(self._port.closePort)
            owner.end()

    def __enter__(self) -> DynamixelBus:
        self.open()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    @property
    def errors(self) -> dict[str, int]:
        """Counts of what went wrong and was mended.

        "timeouts", "corrupt", "unexpected" replies, "echoes" of what was sent, "retries", "fallbacks" (group reads
        done one by one) and "stale_bytes" (that came when none were expected).
        """
        return {**self._line.counts, "stale_bytes": self._port.stale_bytes}

    @property
    def alarms(self) -> dict[int, tuple[str, ...]]:
        """Names of the alarm bits that each servo sent last; "alert" where the servo sends but one bit for all."""
        return {servo_id: self._alarm_names(servo_id, bits) for servo_id, bits in [*self._line.alarms.items()]}

    def label(self, servo_id: int, joint: str) -> None:
        """Name the joint that a servo belongs to, for the messages."""
        self._labels[servo_id] = joint

    def joint(self, servo_id: int) -> str | None:
        """The joint that a servo belongs to, None where it isn't known."""
        return self._labels.get(servo_id)

    def describe(self, servo_id: int) -> str:
        """A servo in a message: "servo 3 (elbow)"."""
        return self._line.describe(servo_id)

    @property
    def where(self) -> str:
        """The port in a message."""
        return self._line.where

    def ping(self, servo_id: SupportsIndex) -> int:
        """The model number of a servo; raises NoReply if there is none."""
        servo_id = operator.index(servo_id)
        return self._owned(lambda: self._ping(servo_id))

    def model(self, servo_id: int) -> ServoModel:
        """The model of a servo, asked for once; raises DriverError for one whose control table isn't here."""
        known = self._models.get(servo_id)
        return known if known is not None else self._owned(lambda: self._model(servo_id))

    def read(self, servo_id: SupportsIndex, register: str) -> int:
        """The value of a register, signed where the register is."""
        servo_id = operator.index(servo_id)

        def read() -> int:
            at = self._model(servo_id).register(register)
            return at.decode(self._line.read(servo_id, at.address, at.size).data)

        return self._owned(read)

    def write(self, servo_id: SupportsIndex, register: str, value: SupportsIndex) -> None:
        """Write a register and wait for the servo to confirm; raises ServoFault if it refuses."""
        servo_id, value = operator.index(servo_id), operator.index(value)

        def write() -> None:
            at = self._model(servo_id).register(register)
            self._line.write(servo_id, at.address, at.encode(value), f"writing {value} to '{register}'")

        self._owned(write)

    def reboot(self, servo_id: SupportsIndex) -> None:
        """Restart a servo, as its alarms demand; its torque is off then. Protocol 2.0 only."""
        servo_id = operator.index(servo_id)
        if self.protocol != 2.0:
            raise DriverError(f"{self.describe(servo_id)} on {self.where}: protocol 1.0 has no reboot; switch it off")
        self._owned(lambda: self._line.reboot(servo_id))

    def sync_write(self, register: str, values: Mapping[int, SupportsIndex]) -> int:
        """Write a register of several servos at once; no servo confirms it. The stamp (ns) is of the sending."""

        def write() -> int:
            groups: dict[tuple[int, int], list[list[int]]] = {}
            for servo_id, value in values.items():
                at = self._model(servo_id).register(register)
                row = [operator.index(servo_id), *at.encode(operator.index(value))]
                groups.setdefault((at.address, at.size), []).append(row)
            return min(self._line.sync_write(address, size, rows) for (address, size), rows in groups.items())

        return self._owned(write)

    def read_many(self, servo_ids: Iterable[int], register: str) -> dict[int, Reading]:
        """A register of several servos; how, and with what stamps, `read_blocks` says."""
        blocks = self.read_blocks({servo_id: (register,) for servo_id in servo_ids})
        return {
            servo_id: Reading(block.values[register], block.t_request_ns, block.t_reply_ns)
            for servo_id, block in blocks.items()
        }

    def read_blocks(self, registers: Mapping[int, Sequence[str]]) -> dict[int, Block]:
        """Several registers of each servo at once: all bytes from the first of them to the last.

        Servos whose bytes are at the same place answer one instruction, where they have such (sync read in protocol
        2.0, bulk read of MX servos in 1.0), each with the stamps of its turn; others, and all after a group read that
        failed, are asked one after the other.
        """

        def read() -> dict[int, Block]:
            layouts = {servo_id: self._layout(servo_id, tuple(names)) for servo_id, names in registers.items()}
            groups: dict[tuple[int, int], list[int]] = {}
            for servo_id, layout in layouts.items():
                groups.setdefault((layout.start, layout.size), []).append(servo_id)
            return {
                servo_id: layouts[servo_id].block(answer)
                for (start, size), group in groups.items()
                for servo_id, answer in self._read_group(group, start, size).items()
            }

        return self._owned(read)

    def _owned(self, work: Callable[[], T]) -> T:
        """Have the owner thread do something, and wait for it."""
        owner = self._owner
        try:
            if owner is None:
                raise OwnerEnded
            return owner.do(work)
        except OwnerEnded:
            raise BusLost(f"{self.path} isn't open; call open() first") from None
        except BusLost:
            self.close()
            raise

    def _ping(self, servo_id: int) -> int:
        number = self._line.ping(servo_id)
        if (model := model_by_number(number)) is not None and self._models.get(servo_id) is not model:
            self._models[servo_id] = model
            self._layouts.clear()  # another servo has taken its place
        return number

    def _model(self, servo_id: int) -> ServoModel:
        if servo_id not in self._models:
            number = self._ping(servo_id)
            if servo_id not in self._models:
                raise DriverError(
                    f"{self.describe(servo_id)} on {self.where} is of a model (number {number}) whose control table "
                    "isn't known; add it to drivers/servo_models"
                )
        return self._models[servo_id]

    def _layout(self, servo_id: int, names: tuple[str, ...]) -> _Layout:
        """Where the registers are, found once."""
        if (servo_id, names) not in self._layouts:
            model = self._model(servo_id)
            self._layouts[servo_id, names] = _Layout([model.register(name) for name in names])
        return self._layouts[servo_id, names]

    def _read_group(self, group: Sequence[int], start: int, size: int) -> dict[int, Answer]:
        answers: dict[int, Answer] = {}
        if len(group) > 1 and self.protocol == 2.0:
            answers = self._line.sync_read(group, start, size)
        elif len(group) > 1 and all(self._model(servo_id).bulk_read for servo_id in group):
            answers = self._line.bulk_read(group, start, size)
        return answers or {servo_id: self._line.read(servo_id, start, size) for servo_id in group}

    def _alarm_names(self, servo_id: int, bits: int) -> tuple[str, ...]:
        if self.protocol == 2.0:
            return (ALERT,)
        model = self._models.get(servo_id)
        return model.error_names(bits) if model else tuple(f"bit {bit}" for bit in range(8) if bits >> bit & 1)
