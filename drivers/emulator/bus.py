"""A servo bus behind a pseudo-terminal: servos that any Dynamixel client can talk to, with the timing of a real bus."""

from __future__ import annotations

import os
import select
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from pathlib import Path
from types import TracebackType

from drivers.clock import Clock
from drivers.emulator.faults import Fault
from drivers.emulator.pseudo_terminal import PseudoTerminal
from drivers.emulator.servo import EmulatedServo
from drivers.emulator.wire import Sending, Wire
from drivers.errors import DriverError
from drivers.packets import Frame, FrameReader

# s. A packet that stops arriving for this long is forgotten. Real time: it guards against a client that died.
PACKET_TIMEOUT_S = 0.1
# s. How often the clock is looked at for faults to come: it may be a virtual one, that nobody waits on meanwhile.
_LOOK_S = 0.01
_CLOSE, _UNPLUG, _REPLUG = b"c", b"u", b"r"

# Turns the reply of a servo (id, bytes) into what arrives: [(ns after it was due, bytes)]; for faults.
AlterReply = Callable[[int, bytes], Iterable[tuple[int, bytes]]]


class EmulatedBus:
    """Servos on one wire, of any models and protocols, behind a pseudo-terminal whose path is `path`.

    Wire time (10 bits a byte at the client's baud) and return delays pass on `clock`: nobody waits on a virtual one. A
    servo at another baud than the client's hears and says nothing.

    The bus moves a virtual clock only while the client waits for a reply. After an instruction that has none (a sync
    write), let the client send one that has, before it moves the clock itself: then every run is the same.

    Args:
        servos: with distinct ids; each speaks its own protocol.
        baud: what all servos are set to; None leaves each at its own.
        clock: the time that the bus lives in.
        faults: what goes wrong when, in seconds since the start.
        seed: of everything random.
        link: the path of the device; in a temporary folder if None.
        fragment_bytes: send replies in pieces of this size.
        alter_reply: for faults that are none of the list: changes, delays or drops replies.
    """

    def __init__(
        self,
        servos: Sequence[EmulatedServo],
        *,
        baud: int | None = None,
        clock: Clock,
        faults: Sequence[Fault] = (),
        seed: int = 0,
        link: Path | None = None,
        fragment_bytes: int | None = None,
        alter_reply: AlterReply | None = None,
    ) -> None:
        if baud is not None:
            for servo in servos:
                _set_baud(servo, baud)
        self._clock, self._link = clock, link
        self._fragment_bytes, self._alter_reply = fragment_bytes, alter_reply
        self._make_wire = partial(Wire, servos, faults=faults, seed=seed)
        self._wire = self._make_wire(start_ns=clock.now_ns())
        self._readers = {protocol: FrameReader(protocol) for protocol in sorted(self._wire.protocols)}
        self._last_byte_s = 0.0
        self._thread: threading.Thread | None = None
        self._failure: BaseException | None = None
        self._folder: tempfile.TemporaryDirectory[str] | None = None
        self._path: Path | None = None
        self._terminal: PseudoTerminal | None = None
        self._unplugged = False  # by `unplug`; a fault may keep the device away too
        self._wake: tuple[int, int] | None = None  # read, write
        self._asking, self._obeyed, self._ended = threading.Lock(), threading.Event(), threading.Event()
        self._ended.set()

    @property
    def path(self) -> str:
        """The device to open, the same after a replug; raises DriverError before start."""
        if self._path is None:
            raise DriverError("the emulated bus isn't started; call start() or use it in a with statement")
        return str(self._path)

    def start(self) -> None:
        """Open the pseudo-terminal and serve it from a thread; raises DriverError if the link can't be made."""
        if self._thread is not None:
            return
        if self._link is None:
            self._folder = tempfile.TemporaryDirectory(prefix="emulated-bus-")
        path = self._link or Path(self._folder.name if self._folder else "") / "bus"
        try:
            self._terminal = PseudoTerminal(path)
        except BaseException:
            self._remove_folder()
            raise
        self._path, self._unplugged = path, False
        self._wire = self._make_wire(start_ns=self._clock.now_ns())
        self._forget_begun()
        self._wake = os.pipe()
        self._ended.clear()
        self._thread = threading.Thread(target=self._serve, name=f"emulated-bus {path}", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """End the thread and take the device away; raises what the thread failed with, if it did."""
        if self._thread is None or self._wake is None:
            return
        os.write(self._wake[1], _CLOSE)
        self._thread.join()
        for fd in self._wake:
            os.close(fd)
        self._remove_folder()
        self._thread, self._wake, self._path = None, None, None
        if self._failure is not None:
            failure, self._failure = self._failure, None
            raise failure

    def wait(self) -> None:
        """Return when the bus has ended: it was closed elsewhere, or has failed."""
        self._ended.wait()  # a thread's join, interrupted by a signal, takes the thread for ended

    def summary(self) -> str:
        """What is on the bus, for people."""
        groups = Counter((servo.model.name, servo.protocol, servo.baud) for servo in self._wire.servos)
        return ", ".join(
            f"{count} {name} (protocol {protocol:.1f}, {baud} baud)" for (name, protocol, baud), count in groups.items()
        )

    def unplug(self) -> None:
        """Take the device away, as by pulling the adapter's plug; the servos keep their power."""
        self._ask(_UNPLUG)

    def replug(self) -> None:
        """Bring the device back, at the same path."""
        self._ask(_REPLUG)

    def __enter__(self) -> EmulatedBus:
        self.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def shaft_rad(self, servo_id: int, t_ns: int) -> float:
        """True shaft angle, rad from the model's zero count, at a time of the last seconds; raises DriverError else."""
        with self._wire.lock:
            self._wire.befall(min(t_ns, self._clock.now_ns()))
            return self._wire.servo(servo_id).shaft_rad(t_ns)

    def register(self, servo_id: int, name: str) -> int:
        """What a servo's register holds, as it was last written or sampled; raises DriverError for none."""
        with self._wire.lock:
            return self._wire.servo(servo_id).get(name)

    def raise_alarm(self, servo_id: int, name: str) -> None:
        """Let a servo fail now, for instance with "overload"."""
        with self._wire.lock:
            self._wire.servo(servo_id).raise_alarm(name, self._clock.now_ns())

    def _ask(self, what: bytes) -> None:
        """Have the thread do something, and wait until it has."""
        with self._asking:
            if self._thread is None or self._wake is None:
                raise DriverError("the emulated bus isn't started: there is nothing to unplug")
            self._obeyed.clear()
            os.write(self._wake[1], what)
            while not self._obeyed.wait(_LOOK_S) and self._thread.is_alive():
                pass

    def _serve(self) -> None:
        try:
            while self._step():
                pass
        except BaseException as failure:  # a thread can't raise to anyone: kept for close()
            self._failure = failure
        finally:
            if self._terminal is not None:
                self._terminal.close()
                self._terminal = None
            self._ended.set()

    def _step(self) -> bool:
        """Wait for bytes, a wish or a fault, and see to it; False when the bus is to end."""
        if self._wake is None:
            return False
        self._wire.advance(self._clock.now_ns())
        self._plug_or_unplug()
        ready, _, _ = select.select(
            [self._wake[0], *([self._terminal.fd] if self._terminal else [])], [], [], self._patience_s()
        )
        if self._wake[0] in ready:
            wish = os.read(self._wake[0], 1)
            if wish == _CLOSE:
                return False
            self._unplugged = wish == _UNPLUG
            self._plug_or_unplug()
            self._obeyed.set()
        elif self._terminal is not None and ready:
            self._listen(self._terminal)
        return True

    def _patience_s(self) -> float | None:
        """How long nothing may come before the faults are looked at; None if there are none to come."""
        next_ns = self._wire.next_change_ns()
        if next_ns is None:
            return None
        return min(_LOOK_S, max(0.0, (next_ns - self._clock.now_ns()) * 1e-9))

    def _plug_or_unplug(self) -> None:
        plugged = self._wire.plugged and not self._unplugged
        if self._terminal is not None and not plugged:
            self._terminal.close()
            self._terminal = None
            self._forget_begun()
        elif self._terminal is None and plugged and self._path is not None:
            self._terminal = PseudoTerminal(self._path)

    def _listen(self, terminal: PseudoTerminal) -> None:
        """Take what the client has sent, and answer it."""
        data = terminal.receive()
        now_s = time.monotonic()
        if now_s - self._last_byte_s > PACKET_TIMEOUT_S:
            self._forget_begun()
        self._last_byte_s = now_s
        baud = terminal.client_baud()
        for protocol, frame in self._frames(data):
            for sending in self._wire.hear(frame, protocol, baud, self._clock.now_ns()):
                self._send(terminal, sending)
            self._plug_or_unplug()
            if self._terminal is not terminal:
                return

    def _frames(self, data: bytes) -> Iterable[tuple[float, Frame]]:
        """The packets that `data` completes, in the order in which they end."""
        if len(self._readers) == 1:
            for protocol, reader in self._readers.items():
                for frame in reader.feed(data):
                    yield protocol, frame
            return
        for at in range(len(data)):  # byte by byte, so that packets of two protocols come in their order
            for protocol, reader in self._readers.items():
                for frame in reader.feed(data[at : at + 1]):
                    if protocol == 2.0 and frame.intact:  # what looked like a header of protocol 1.0 was inside it
                        self._readers[1.0].clear()
                    yield protocol, frame

    def _send(self, terminal: PseudoTerminal, sending: Sending) -> None:
        alter = self._alter_reply
        for later_ns, data in alter(sending.servo_id, sending.data) if alter else ((0, sending.data),):
            self._clock.sleep_until_ns(sending.due_ns + later_ns)
            size = self._fragment_bytes or max(1, len(data))
            for at in range(0, len(data), size):
                terminal.send(data[at : at + size])

    def _forget_begun(self) -> None:
        for reader in self._readers.values():
            reader.clear()

    def _remove_folder(self) -> None:
        if self._folder is not None:
            self._folder.cleanup()
            self._folder = None


def _set_baud(servo: EmulatedServo, baud: int) -> None:
    """Set a servo to a baud; raises DriverError if it hasn't got it."""
    codes = {known: code for code, known in servo.model.baud_codes.items()}
    if baud not in codes:
        have = ", ".join(map(str, codes))
        raise DriverError(f"servo {servo.id}: {servo.model.name} has no baud {baud}; it has {have}")
    servo.set("baud_rate", codes[baud])
