"""A servo bus behind a pseudo-terminal: servos that any Dynamixel client can talk to, with the timing of a real bus."""

from __future__ import annotations

import fcntl
import os
import select
import struct
import sys
import termios
import threading
import time
import tty
from collections.abc import Callable, Iterable, Sequence
from types import TracebackType

from drivers.clock import Clock
from drivers.emulated_servo import EmulatedServo, Refusal, Refused
from drivers.errors import DriverError
from drivers.packets import BROADCAST, Frame, FrameReader, Instruction, encode_status

BITS_PER_BYTE = 10  # e-manual, Protocol: 8 bits, 1 start bit, 1 stop bit, no parity
# s. A packet that stops arriving for this long is forgotten. Real time: it guards against a client that died.
PACKET_TIMEOUT_S = 0.1
_TCGETS2 = 0x802C542A  # linux/asm-generic/ioctls.h: termios2, which holds the baud as a number
_TERMIOS2_BYTES, _OSPEED_AT = 44, 40

# Error byte of the status packet (e-manual, Status Packet, Error).
_ERRORS_1 = {
    Refusal.INSTRUCTION: 64, Refusal.RANGE: 8, Refusal.LENGTH: 8, Refusal.ACCESS: 8, Refusal.LIMIT: 2,
}  # fmt: skip
_ERRORS_2 = {
    Refusal.INSTRUCTION: 2, Refusal.RANGE: 4, Refusal.LENGTH: 5, Refusal.LIMIT: 6, Refusal.ACCESS: 7,
}  # fmt: skip
_CHECKSUM_1, _CRC_2, _ALERT_2 = 16, 3, 0x80
_ANSWERED_FROM: dict[int, int] = {Instruction.PING: 0, Instruction.READ: 1}

# Turns the reply of a servo (id, bytes) into what arrives: [(ns after it was due, bytes)]; for faults.
AlterReply = Callable[[int, bytes], Iterable[tuple[int, bytes]]]


class EmulatedBus:
    """Servos on one wire, behind a pseudo-terminal whose path is `path`.

    Wire time (10 bits a byte at `baud`) and return delays pass on `clock`: nobody waits on a virtual one. A client
    at another baud than a servo's gets no answer from it. Servos start at their own defaults, but for the baud.

    The bus moves a virtual clock only while the client waits for a reply. After an instruction that has none (a sync
    write), let the client send one that has, before it moves the clock itself: then every run is the same.

    Args:
        servos: with distinct ids.
        protocol: 1.0 or 2.0, of all servos.
        baud: what the servos are set to.
        clock: the time that the bus lives in.
        fragment_bytes: send replies in pieces of this size.
        alter_reply: for faults: changes, delays or drops replies.
    """

    def __init__(
        self,
        servos: Sequence[EmulatedServo],
        *,
        protocol: float,
        baud: int,
        clock: Clock,
        fragment_bytes: int | None = None,
        alter_reply: AlterReply | None = None,
    ) -> None:
        if protocol not in (1.0, 2.0):
            raise DriverError(f"no protocol {protocol:g}; have 1.0 and 2.0")
        self._servos = {servo.id: servo for servo in servos}
        if len(self._servos) != len(servos):
            raise DriverError("two emulated servos have one id; give each its own")
        for servo in servos:
            _configure(servo, protocol, baud)
        self._protocol, self._baud, self._clock = protocol, baud, clock
        self._fragment_bytes, self._alter_reply = fragment_bytes, alter_reply
        self._reader = FrameReader(protocol)
        # How far the bus has got. It runs ahead of the clock until a reply is due, so that the clock moves only while
        # the client waits for it: a client that reads the clock after a sync write reads the same in every run.
        self._line_ns = 0
        self._lock = threading.Lock()  # over the servos' state
        self._thread: threading.Thread | None = None
        self._failure: BaseException | None = None
        self._ends: tuple[int, int, int, int] | None = None  # master, slave, wake read, wake write
        self._path: str | None = None

    @property
    def path(self) -> str:
        """The device to open; raises DriverError before start."""
        if self._path is None:
            raise DriverError("the emulated bus isn't started; call start() or use it in a with statement")
        return self._path

    def start(self) -> None:
        """Open the pseudo-terminal and serve it from a thread."""
        if self._thread is not None:
            return
        master, slave = os.openpty()
        tty.setraw(slave)  # or the line discipline would echo and edit
        wake_read, wake_write = os.pipe()
        os.set_blocking(master, False)
        self._ends = master, slave, wake_read, wake_write
        self._path = os.ttyname(slave)
        self._reader.clear()
        self._thread = threading.Thread(target=self._serve, name=f"emulated-bus {self._path}", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Unplug: the thread ends, the device is gone; raises what the thread failed with, if it did."""
        if self._thread is None or self._ends is None:
            return
        os.write(self._ends[3], b"x")
        self._thread.join()
        for fd in self._ends:
            os.close(fd)
        self._thread, self._ends, self._path = None, None, None
        if self._failure is not None:
            failure, self._failure = self._failure, None
            raise failure

    def __enter__(self) -> EmulatedBus:
        self.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def shaft_rad(self, servo_id: int, t_ns: int) -> float:
        """True shaft angle, rad from the model's zero count, at a time of the last seconds; raises DriverError else."""
        with self._lock:
            return self._servo(servo_id).shaft_rad(t_ns)

    def raise_alarm(self, servo_id: int, name: str) -> None:
        """Let a servo fail now, for instance with "overload"."""
        with self._lock:
            self._servo(servo_id).raise_alarm(name, self._clock.now_ns())

    def _servo(self, servo_id: int) -> EmulatedServo:
        if servo_id not in self._servos:
            raise DriverError(f"no emulated servo {servo_id}; have {', '.join(map(str, self._servos))}")
        return self._servos[servo_id]

    def _serve(self) -> None:
        ends = self._ends
        if ends is None:
            return
        master, slave, wake, _ = ends
        last_s = time.monotonic()
        try:
            while True:
                ready, _, _ = select.select([master, wake], [], [])
                if wake in ready:
                    return
                data = os.read(master, 4096)
                now_s = time.monotonic()
                if now_s - last_s > PACKET_TIMEOUT_S:
                    self._reader.clear()
                last_s = now_s
                client_baud = _client_baud(slave)
                for frame in self._reader.feed(data):
                    self._answer(frame, client_baud or self._baud)
        except BaseException as failure:  # a thread can't raise to anyone: kept for close()
            self._failure = failure

    def _answer(self, frame: Frame, client_baud: int) -> None:
        """Let the frame pass over the wire, have it done, send the replies."""
        self._line_ns = max(self._line_ns, self._clock.now_ns())
        self._pass(self._wire_ns(frame.wire_bytes))
        listening = {id: servo for id, servo in self._servos.items() if servo.baud == client_baud}
        if not frame.intact:
            if frame.servo_id in listening:
                self._reply(listening[frame.servo_id], _CHECKSUM_1 if self._protocol == 1.0 else _CRC_2, b"")
            return
        instruction, parameters = frame.body[0], frame.body[1:]
        if frame.servo_id == BROADCAST:
            self._broadcast(instruction, parameters, listening)
        elif frame.servo_id in listening:
            self._single(listening[frame.servo_id], instruction, parameters)
        self._rename()

    def _single(self, servo: EmulatedServo, instruction: int, parameters: bytes) -> None:
        # e-manual, Status Return Level: 0 answers pings alone, 1 reads too, 2 everything.
        answers = servo.get("status_return_level") >= _ANSWERED_FROM.get(instruction, 2)
        if instruction == Instruction.READ and answers:
            self._pass(servo.return_delay_ns)  # the answer is of the moment at which it is sent
            self._reply(servo, *self._attempt(servo, instruction, parameters), delay=False)
            return
        error, reply = self._attempt(servo, instruction, parameters)
        if answers:
            self._reply(servo, error, reply)

    def _attempt(self, servo: EmulatedServo, instruction: int, parameters: bytes) -> tuple[int, bytes]:
        """Have a servo do an instruction; its error byte and parameters."""
        with self._lock:
            try:
                return 0, self._execute(servo, instruction, parameters)
            except Refused as refused:
                errors = _ERRORS_1 if self._protocol == 1.0 else _ERRORS_2
                return errors[refused.reason], b""

    def _execute(self, servo: EmulatedServo, instruction: int, parameters: bytes) -> bytes:
        now_ns = self._line_ns
        wide = self._protocol == 2.0  # addresses and lengths take two bytes
        match instruction:
            case Instruction.PING:
                firmware = servo.get("firmware_version")
                return servo.get("model_number").to_bytes(2, "little") + bytes((firmware,)) if wide else b""
            case Instruction.READ:
                address, length = _numbers(parameters, 2, wide=wide)
                return servo.read(address, length, now_ns)
            case Instruction.WRITE | Instruction.REG_WRITE:
                width = 2 if wide else 1
                (address,) = _numbers(parameters[:width], 1, wide=wide)
                if instruction == Instruction.WRITE:
                    servo.write(address, parameters[width:], now_ns)
                else:
                    servo.register_write(address, parameters[width:])
            case Instruction.ACTION:
                servo.action(now_ns)
            case Instruction.FACTORY_RESET:
                servo.factory_reset(now_ns, keep=_kept(parameters) if wide else ())
            case Instruction.REBOOT if wide:
                servo.reboot(now_ns)
            case _:
                raise Refused(Refusal.INSTRUCTION)
        return b""

    def _broadcast(self, instruction: int, parameters: bytes, servos: dict[int, EmulatedServo]) -> None:
        wide = self._protocol == 2.0
        match instruction:
            case Instruction.PING if wide:
                for id in sorted(servos):
                    self._single(servos[id], instruction, parameters)
            case Instruction.WRITE | Instruction.REG_WRITE | Instruction.ACTION | Instruction.REBOOT:
                for servo in servos.values():  # all do it, none answers
                    self._attempt(servo, instruction, parameters)
            case Instruction.SYNC_WRITE:
                for id, request in _sync_write(parameters, wide=wide):
                    if id in servos:
                        self._attempt(servos[id], Instruction.WRITE, request)
            case Instruction.BULK_WRITE if wide:
                for id, request in _bulk_write(parameters):
                    if id in servos:
                        self._attempt(servos[id], Instruction.WRITE, request)
            case Instruction.SYNC_READ if wide:
                self._group_read([(id, parameters[:4]) for id in parameters[4:]], servos)
            case Instruction.BULK_READ:
                self._group_read(_bulk_read(parameters, wide=wide), servos)
            case _:
                pass  # unknown broadcasts are silence

    def _group_read(self, requests: Sequence[tuple[int, bytes]], servos: dict[int, EmulatedServo]) -> None:
        """Answer one after the other: each waits for the one before, so that all fall silent after a missing one."""
        for id, request in requests:
            servo = servos.get(id)
            if servo is None or not servo.model.group_read or servo.get("status_return_level") < 1:
                return
            self._pass(servo.return_delay_ns)
            self._reply(servo, *self._attempt(servo, Instruction.READ, request), delay=False)

    def _reply(self, servo: EmulatedServo, error: int, parameters: bytes, *, delay: bool = True) -> None:
        if delay:
            self._pass(servo.return_delay_ns)
        if self._protocol == 1.0:
            error |= servo.alarm
        elif servo.alarm:
            error |= _ALERT_2
        reply = encode_status(servo.id, error, parameters, self._protocol)
        self._pass(self._wire_ns(len(reply)))
        for later_ns, data in self._alter_reply(servo.id, reply) if self._alter_reply else ((0, reply),):
            self._clock.sleep_until_ns(self._line_ns + later_ns)
            self._send(data)

    def _send(self, data: bytes) -> None:
        if self._ends is None:
            return
        size = self._fragment_bytes or max(1, len(data))
        for at in range(0, len(data), size):
            try:
                os.write(self._ends[0], data[at : at + size])
            except BlockingIOError:
                return  # nobody reads, and the line's buffer is full: the bytes are lost, as on a wire

    def _rename(self) -> None:
        """Find the servos by their present ids: a write may have changed one."""
        if any(id != servo.id for id, servo in self._servos.items()):
            with self._lock:
                self._servos = {servo.id: servo for servo in self._servos.values()}

    def _wire_ns(self, count: int) -> int:
        return count * BITS_PER_BYTE * 1_000_000_000 // self._baud

    def _pass(self, duration_ns: int) -> None:
        self._line_ns += duration_ns


def _configure(servo: EmulatedServo, protocol: float, baud: int) -> None:
    """Set a servo up for this bus; raises DriverError if it can't be."""
    if protocol not in servo.model.protocols:
        spoken = " and ".join(f"{known:.1f}" for known in servo.model.protocols)
        raise DriverError(f"servo {servo.id}: {servo.model.name} speaks protocol {spoken}, the bus {protocol:.1f}")
    codes = {known: code for code, known in servo.model.baud_codes.items()}
    if baud not in codes:
        have = ", ".join(map(str, codes))
        raise DriverError(f"servo {servo.id}: {servo.model.name} has no baud {baud}; it has {have}")
    servo.set("baud_rate", codes[baud])
    if "protocol_type" in servo.model.registers:
        servo.set("protocol_type", int(protocol))


def _client_baud(slave: int) -> int | None:
    """The baud that the client has set, None where the system doesn't tell."""
    if not sys.platform.startswith("linux"):
        return None
    try:
        termios2 = fcntl.ioctl(slave, _TCGETS2, bytes(_TERMIOS2_BYTES))
    except (OSError, termios.error):
        return None
    return int(struct.unpack_from("I", termios2, _OSPEED_AT)[0])


def _numbers(parameters: bytes, count: int, *, wide: bool) -> tuple[int, ...]:
    """Addresses and lengths; refused if the parameters are of another size."""
    width = 2 if wide else 1
    if len(parameters) != count * width:
        raise Refused(Refusal.LENGTH)
    return tuple(int.from_bytes(parameters[at : at + width], "little") for at in range(0, len(parameters), width))


def _kept(parameters: bytes) -> tuple[str, ...]:
    """What a factory reset keeps (e-manual 2.0, Factory Reset): 0xFF nothing, 1 the id, 2 the id and the baud."""
    kept = {b"\xff": (), b"\x01": ("id",), b"\x02": ("id", "baud_rate")}
    if parameters not in kept:
        raise Refused(Refusal.RANGE)
    return kept[parameters]


def _sync_write(parameters: bytes, *, wide: bool) -> list[tuple[int, bytes]]:
    """(id, write parameters) of each servo (e-manual, Sync Write)."""
    width = 2 if wide else 1
    address, length = parameters[:width], int.from_bytes(parameters[width : 2 * width], "little")
    data = parameters[2 * width :]
    step = length + 1
    return [(data[at], address + data[at + 1 : at + step]) for at in range(0, len(data) - length, step)]


def _bulk_write(parameters: bytes) -> list[tuple[int, bytes]]:
    """(id, write parameters) of each servo (e-manual 2.0, Bulk Write): id, address, length, data."""
    writes: list[tuple[int, bytes]] = []
    while len(parameters) > 5:
        end = 5 + int.from_bytes(parameters[3:5], "little")
        writes.append((parameters[0], parameters[1:3] + parameters[5:end]))
        parameters = parameters[end:]
    return writes


def _bulk_read(parameters: bytes, *, wide: bool) -> list[tuple[int, bytes]]:
    """(id, read parameters) of each servo; protocol 1.0: a zero, then (length, id, address) each."""
    if wide:
        return [(parameters[at], parameters[at + 1 : at + 5]) for at in range(0, len(parameters) - 4, 5)]
    rows = [parameters[at : at + 3] for at in range(1, len(parameters) - 2, 3)]
    return [(row[1], bytes((row[2], row[0]))) for row in rows]
