"""The parsers of packets against random and mutated byte strings: no exception, no hang, nothing false.

Every string goes through four parsers: `drivers.packets.FrameReader` of both protocols, in pieces, and the driver's
receiving path of both (`drivers.sdk_fence`) over a port that hands the bytes over in pieces and then times out. Wanted:

- no exception at all: these two raise none of their own, a lost port aside;
- at most READS_PER_BYTE readings of the port for each byte, and a few: no hang;
- frames: those that a plain scan of the string finds, no more and no less;
- replies: each is in the string, byte for byte, with its right checksum.

Strings: random bytes, some of them with more header bytes than chance gives; packets of both protocols with noise
between; and packets with flipped, inserted, deleted, doubled and swapped bytes, cut short, spliced, with another length
or with stuffing put in.

Run: python -m tests.benchmarks.packet_fuzz [--seed N] [--trials N] [--quick] [--workers N]
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from random import Random

from dynamixel_sdk import COMM_RX_TIMEOUT

from drivers.packets import FrameReader, Instruction, crc16, encode_instruction, encode_status, unstuff
from drivers.sdk_fence import Status, make_handler
from tests.benchmarks.arguments import each, parser, trials_of

STRINGS, QUICK_STRINGS = 1_000_000, 20_000
STRINGS_PER_JOB = 5_000
# A reading brings a byte, or follows the removal of one, a reply's end, or a header that told a length.
READS_PER_BYTE, FEW_READS = 4, 8
PROTOCOLS = (1.0, 2.0)
TRICKY = bytes((0xFF, 0xFF, 0xFF, 0xFD, 0xFD, 0x00, 0x55, 0x01, 0x02, 0x03, 0x07))  # of headers, stuffing and lengths
STUFFING = (b"\xff\xff\xfd", b"\xff\xff\xfd\xfd", b"\xff\xff\xfd\x00", b"\xff\xff", b"\xff\xff\xfd\xfd\xfd")
LONG_SHARE = 0.01  # of packets as long as the protocol allows


@dataclass(frozen=True)
class Found:
    """A packet in a string: where, how long, and whether its checksum is right."""

    at: int
    size: int
    intact: bool


def packet_at(data: bytes, at: int, protocol: float) -> Found | None:
    """What begins at a place by its header, id and length; None where that is no packet, or none that is whole."""
    if protocol == 1.0:
        if data[at : at + 2] != b"\xff\xff" or at + 4 > len(data) or data[at + 2] == 0xFF or data[at + 3] < 2:
            return None
        size = 4 + data[at + 3]
        intact = sum(data[at + 2 : at + size]) % 256 == 0xFF
    else:
        if data[at : at + 4] != b"\xff\xff\xfd\x00" or at + 7 > len(data) or data[at + 4] in (0xFD, 0xFF):
            return None
        length = data[at + 5] + 256 * data[at + 6]
        if not 3 <= length <= 1024:
            return None
        size = 7 + length
        intact = data[at + size - 2 : at + size] == crc16(data[at : at + size - 2]).to_bytes(2, "little")
    return Found(at, size, intact and at + size <= len(data))


def scan(data: bytes, protocol: float) -> list[Found]:
    """The packets of a string, from its beginning: after one with a wrong checksum the search goes on a byte later.

    It ends where a packet has begun that isn't whole: what follows may yet belong to it.
    """
    found: list[Found] = []
    at = 0
    while (at := data.find(b"\xff\xff", at)) >= 0:
        packet = packet_at(data, at, protocol)
        if packet is None:
            at += 1
        elif at + packet.size > len(data):
            break
        else:
            found.append(packet)
            at += packet.size if packet.intact else 1
    return found


def statuses_anywhere(data: bytes, protocol: float) -> set[Status]:
    """Every status packet with a right checksum that begins anywhere in a string, inside another one or not."""
    statuses: set[Status] = set()
    for at in range(len(data)):
        packet = packet_at(data, at, protocol)
        if packet is None or not packet.intact:
            continue
        if protocol == 1.0:
            body = data[at + 4 : at + packet.size - 1]
        else:
            body = unstuff(data[at + 7 : at + packet.size - 2])
            if body[:1] != b"\x55":
                continue
            body = body[1:]
        if body:
            statuses.add(Status(data[at + 2 if protocol == 1.0 else at + 4], body[0], body[1:]))
    return statuses


class Hang(Exception):
    """The port was read more often than its bytes explain."""


class TimedBytes:
    """A port as the SDK's packet handlers see one: hands over bytes, at most `piece` at a time, then times out."""

    def __init__(self, data: bytes, piece: int) -> None:
        self._data, self._piece, self._at = data, piece, 0
        self._reads_left = READS_PER_BYTE * len(data) + FEW_READS
        self.is_using = False
        self.sent = b""  # nothing that could come back as an echo
        self.taken_bytes = 0

    # The names of the methods are the SDK's.
    def readPort(self, length: int) -> bytes:
        self._reads_left -= 1
        if self._reads_left < 0:
            raise Hang
        chunk = self._data[self._at : self._at + min(self._piece, max(0, length))]
        self._at += len(chunk)
        self.taken_bytes += len(chunk)
        return chunk

    def isPacketTimeout(self) -> bool:
        return self._at == len(self._data)


def received(data: bytes, protocol: float, piece: int) -> list[Status]:
    """The replies that the driver's receiving path finds in a string until nothing comes any more."""
    port, handler = TimedBytes(data, piece), make_handler(protocol)
    statuses: list[Status] = []
    while True:
        status, result = handler.receive(port)
        if status is not None:
            statuses.append(status)
        elif result == COMM_RX_TIMEOUT:
            return statuses


def _parameters(rng: Random, protocol: float) -> bytes:
    most = 24 if rng.random() > LONG_SHARE else 250 if protocol == 1.0 else 760  # 760: short enough when stuffed
    size = rng.randrange(most)
    return rng.randbytes(size) if rng.random() < 0.5 else bytes(rng.choices(TRICKY, k=size))


def packet(rng: Random, protocol: float) -> bytes:
    """A packet as it should be."""
    parameters = _parameters(rng, protocol)
    if rng.random() < 0.5:
        return encode_status(rng.randrange(253), rng.choice((0, 0, 4, 0x24)), parameters, protocol)
    servo_id = rng.choice((1, 2, 3, 0xFE, rng.randrange(253)))
    return encode_instruction(servo_id, rng.choice(list(Instruction)), parameters, protocol)


def _flip(rng: Random, data: bytearray) -> None:
    data[rng.randrange(len(data))] ^= 1 << rng.randrange(8) if rng.random() < 0.5 else rng.randrange(1, 256)


def _insert(rng: Random, data: bytearray) -> None:
    at = rng.randrange(len(data) + 1)
    data[at:at] = rng.randbytes(rng.randrange(1, 5))


def _delete(rng: Random, data: bytearray) -> None:
    at = rng.randrange(len(data))
    del data[at : at + rng.randrange(1, 5)]


def _double(rng: Random, data: bytearray) -> None:
    at = rng.randrange(len(data))
    data[at:at] = data[at : at + rng.randrange(1, 20)]


def _swap(rng: Random, data: bytearray) -> None:
    a, b = rng.randrange(len(data)), rng.randrange(len(data))
    data[a], data[b] = data[b], data[a]


def _cut(rng: Random, data: bytearray) -> None:
    del data[rng.randrange(len(data)) :]


def _splice(rng: Random, data: bytearray) -> None:
    at = rng.randrange(len(data))
    data[at:] = packet(rng, rng.choice(PROTOCOLS))[rng.randrange(6) :]


def _change_length(rng: Random, data: bytearray) -> None:
    at = rng.choice((3, 5, 6))  # LENGTH of protocol 1.0; of 2.0, low and high
    if at < len(data):
        data[at] = rng.choice((0, 1, 2, 3, 4, 250, 251, 255, rng.randrange(256)))


def _stuff(rng: Random, data: bytearray) -> None:
    at = rng.randrange(len(data) + 1)
    data[at:at] = rng.choice(STUFFING)


MUTATIONS: tuple[Callable[[Random, bytearray], None], ...] = (
    _flip, _insert, _delete, _double, _swap, _cut, _splice, _change_length, _stuff,
)  # fmt: skip


def mutated(rng: Random) -> bytes:
    """One to three packets of one protocol, changed in one to four places."""
    protocol = rng.choice(PROTOCOLS)
    data = bytearray().join(packet(rng, protocol) for _ in range(rng.randrange(1, 4)))
    for _ in range(rng.randrange(1, 5)):
        if data:
            rng.choice(MUTATIONS)(rng, data)
    return bytes(data)


def noise(rng: Random) -> bytes:
    """Random bytes, or bytes that headers are made of."""
    size = rng.randrange(64)
    return rng.randbytes(size) if rng.random() < 0.5 else bytes(rng.choices(TRICKY, k=size))


def mixed(rng: Random) -> bytes:
    """Packets of one protocol as they should be, with noise between them."""
    protocol = rng.choice(PROTOCOLS)
    pieces = ((noise(rng), packet(rng, protocol)) for _ in range(rng.randrange(1, 4)))
    return b"".join(piece for pair in pieces for piece in pair)


def strings(seed: int, count: int) -> Iterator[bytes]:
    """Random and mutated byte strings."""
    rng = Random(seed)
    for _ in range(count):
        yield rng.choices((noise, mixed, mutated), (1, 1, 3))[0](rng)


@dataclass
class Tally:
    """What a parser did with the strings; `failures` by kind, `example` the first of them; times are of the CPU."""

    strings: int = 0
    frames: int = 0
    intact: int = 0
    slowest_s: float = 0.0
    total_s: float = 0.0
    failures: Counter[str] = field(default_factory=Counter[str])
    example: str = ""

    def fail(self, kind: str, data: bytes) -> None:
        self.failures[kind] += 1
        self.example = self.example or f"{kind}: {data.hex(' ')}"

    def time(self, started_s: float) -> None:
        took_s = time.process_time() - started_s
        self.strings += 1
        self.total_s += took_s
        self.slowest_s = max(self.slowest_s, took_s)

    def add(self, other: Tally) -> None:
        self.strings += other.strings
        self.frames += other.frames
        self.intact += other.intact
        self.slowest_s = max(self.slowest_s, other.slowest_s)
        self.total_s += other.total_s
        self.failures += other.failures
        self.example = self.example or other.example


def try_frames(data: bytes, protocol: float, piece: int, tally: Tally) -> None:
    """Read a string by FrameReader."""
    reader = FrameReader(protocol)
    started_s = time.process_time()
    try:
        frames = [frame for at in range(0, len(data), piece) for frame in reader.feed(data[at : at + piece])]
    except Exception as error:  # any is a failure: it is counted
        tally.fail(type(error).__name__, data)
        return
    tally.time(started_s)
    tally.frames += len(frames)
    tally.intact += sum(frame.intact for frame in frames)
    if [(frame.wire_bytes, frame.intact) for frame in frames] != [(f.size, f.intact) for f in scan(data, protocol)]:
        tally.fail("other frames", data)


def try_receiving(data: bytes, protocol: float, piece: int, tally: Tally) -> None:
    """Read a string by the driver's receiving path."""
    started_s = time.process_time()
    try:
        statuses = received(data, protocol, piece)
    except Exception as error:  # any is a failure: it is counted
        tally.fail(type(error).__name__, data)
        return
    tally.time(started_s)
    tally.intact += len(statuses)
    if statuses and not set(statuses) <= statuses_anywhere(data, protocol):
        tally.fail("false reply", data)


PARSERS: dict[str, tuple[Callable[[bytes, float, int, Tally], None], float]] = {
    "FrameReader 1.0": (try_frames, 1.0),
    "FrameReader 2.0": (try_frames, 2.0),
    "receive 1.0": (try_receiving, 1.0),
    "receive 2.0": (try_receiving, 2.0),
}


def fuzz(job: tuple[int, int]) -> dict[str, Tally]:
    """A tally of each parser, for (seed, count of strings)."""
    seed, count = job
    tallies = {name: Tally() for name in PARSERS}
    pieces = Random(seed)
    for data in strings(seed, count):
        piece = pieces.choice((1, 3, 16, 4096))
        for name, (attempt, protocol) in PARSERS.items():
            attempt(data, protocol, piece, tallies[name])
    return tallies


def main() -> None:
    chosen = parser(__doc__, trials=STRINGS, quick=QUICK_STRINGS).parse_args()
    count = trials_of(chosen)
    starts = range(0, count, STRINGS_PER_JOB)
    jobs = [(count * chosen.seed + at, min(STRINGS_PER_JOB, count - at)) for at in starts]  # no seed comes twice
    totals = {name: Tally() for name in PARSERS}
    for tallies in each(fuzz, jobs, chosen.workers):
        for name, tally in tallies.items():
            totals[name].add(tally)
    print(f"{'parser':16} {'strings':>9} {'frames':>9} {'intact':>9} {'failures':>9} {'slowest':>9} {'strings/s':>10}")
    for name, tally in totals.items():
        frames = str(tally.frames) if name.startswith("FrameReader") else "-"
        speed = tally.strings / tally.total_s
        print(
            f"{name:16} {tally.strings:9} {frames:>9} {tally.intact:9} {tally.failures.total():9} "
            f"{tally.slowest_s:7.4f} s {speed:10.0f}"
        )
    for name, tally in totals.items():
        for kind, times in tally.failures.items():
            print(f"{name}: {times} x {kind}")
        if tally.example:
            print(f"{name}: first {tally.example}")
    if any(tally.failures for tally in totals.values()):
        raise SystemExit(1)


if __name__ == "__main__":
    main()
