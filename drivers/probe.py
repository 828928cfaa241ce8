"""Questions to a wire of which nothing is known yet: one instruction, and all that comes back, damaged or twice.

The driver hides what a scan is after (a second reply, garbage, a servo that answers pings alone), so this asks on its
own, by the codec of `drivers.packets` over the same port.
"""

from __future__ import annotations

from dataclasses import dataclass
from types import TracebackType

from drivers.errors import NoPort
from drivers.packets import BROADCAST, MAX_ID, FrameReader, Instruction, Status, encode_instruction, read_status
from drivers.sdk_fence import BITS_PER_BYTE, FencedPort

# s, beside an adapter's latency timer: two USB frames, the longest return delay (0.5 ms), and a busy machine.
MARGIN_S = 0.008
# s for each id that may answer a broadcast ping: the SDK (4.1.0, broadcastPing) waits as long; no manual page says so.
BROADCAST_TURN_S = 0.003
_REPLY_BYTES = 14  # of a ping in protocol 2.0, the longest that is waited for here
_CHUNK_BYTES = 4096


class BaudRefused(NoPort):
    """The port can't be set to a baud."""


@dataclass(frozen=True, slots=True)
class Setting:
    """How a servo may be spoken to."""

    protocol: float
    baud: int

    def __str__(self) -> str:
        return f"{self.baud} baud, protocol {self.protocol:.1f}"


@dataclass(frozen=True, slots=True)
class Heard:
    """What came back after one instruction.

    Attributes:
        statuses: intact status packets, of whatever servo, in order.
        stray_bytes: others: damaged packets, noise, what came late from before.
    """

    statuses: tuple[Status, ...]
    stray_bytes: int

    def of(self, servo_id: int) -> tuple[Status, ...]:
        """The status packets of one servo."""
        return tuple(status for status in self.statuses if status.servo_id == servo_id)

    @property
    def silent(self) -> bool:
        """Whether nothing came at all."""
        return not self.statuses and not self.stray_bytes


class Probe:
    """A port at one setting; open it by `with`.

    Args:
        port: path of the device.
        latency_s: how long the adapter may hold received bytes back: 16 ms in an FTDI one as it comes.

    Raises:
        NoPort: from `with`: the port isn't there, or is held by another program; BaudRefused for the baud.
        BusLost: from all that speaks: the port vanished.
    """

    def __init__(self, port: str, setting: Setting, *, latency_s: float) -> None:
        self.setting = setting
        self._port = FencedPort(port, setting.baud, None)
        self._latency_s = latency_s

    def __enter__(self) -> Probe:
        refused = f"{self._port.path} can't be set to {self.setting.baud} baud"
        try:
            self._port.openPort()
        except OverflowError as error:  # pyserial 3.5, of more than 31 bits
            self._port.closePort()
            raise BaudRefused(refused) from error
        except NoPort as error:
            if isinstance(error.__cause__, ValueError):  # pyserial's word for it
                raise BaudRefused(refused) from error
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._port.closePort()

    @property
    def reply_s(self) -> float:
        """How long a reply is waited for."""
        return self._latency_s + MARGIN_S + 2 * self._wire_s(_REPLY_BYTES)

    @property
    def broadcast_s(self) -> float:
        """How long the replies to a broadcast ping are waited for."""
        return self._latency_s + MARGIN_S + (MAX_ID + 1) * (BROADCAST_TURN_S + self._wire_s(_REPLY_BYTES))

    def ping(self, servo_id: int, *, patience: float = 1.0) -> Heard:
        """Ping a servo; `patience` is a factor on the time that is waited."""
        return self._ask(servo_id, Instruction.PING, b"", self.reply_s * patience)

    def ping_all(self) -> Heard:
        """Ping all servos at once (protocol 2.0)."""
        return self._ask(BROADCAST, Instruction.PING, b"", self.broadcast_s)

    def read(self, servo_id: int, address: int, size: int, *, patience: float = 1.0) -> Heard:
        """Ask a servo for bytes of its control table."""
        wait_s = (self.reply_s + self._wire_s(size)) * patience
        return self._ask(servo_id, Instruction.READ, self._number(address) + self._number(size), wait_s)

    def write(self, servo_id: int, address: int, data: bytes) -> Heard:
        """Write bytes of a servo's control table, whether or not it confirms."""
        return self._ask(servo_id, Instruction.WRITE, self._number(address) + data, self.reply_s)

    def _ask(self, servo_id: int, instruction: Instruction, parameters: bytes, wait_s: float) -> Heard:
        protocol = self.setting.protocol
        packet = encode_instruction(servo_id, instruction, parameters, protocol)
        before = self._port.stale_bytes
        self._port.clearPort()
        late_bytes = self._port.stale_bytes - before
        self._port.writePort(list(packet))
        # Half-duplex adapters may send back what they are sent: in protocol 1.0 that reads as a status packet.
        received = self._listen(servo_id, wait_s).removeprefix(packet)
        frames = [frame for frame in FrameReader(protocol).feed(received) if frame.intact]
        statuses = tuple(status for frame in frames if (status := read_status(frame, protocol)) is not None)
        stray_bytes = len(received) - sum(frame.wire_bytes for frame in frames)
        return Heard(statuses, stray_bytes + late_bytes)

    def _listen(self, servo_id: int, wait_s: float) -> bytes:
        """All bytes until the time is over; after a first reply, of what follows at once."""
        received, lingers = b"", servo_id == BROADCAST
        self._port.setPacketTimeoutMillis(wait_s * 1000)
        while not self._port.isPacketTimeout():
            received += self._port.readPort(_CHUNK_BYTES)
            if not lingers and self._answered(received, servo_id):
                lingers = True
                self._port.setPacketTimeoutMillis(self._latency_s * 1000)
        return received

    def _answered(self, received: bytes, servo_id: int) -> bool:
        frames = FrameReader(self.setting.protocol).feed(received)
        statuses = [read_status(frame, self.setting.protocol) for frame in frames]
        return any(status is not None and status.servo_id == servo_id for status in statuses)

    def _number(self, value: int) -> bytes:
        return value.to_bytes(1 if self.setting.protocol == 1.0 else 2, "little")

    def _wire_s(self, count: int) -> float:
        return count * BITS_PER_BYTE / self.setting.baud
