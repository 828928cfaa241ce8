"""Find the servos on a wire of which baud, protocol and ids are unknown; nothing is ever written to a servo."""

from __future__ import annotations

from collections.abc import Callable, Collection, Generator, Iterator, Sequence
from dataclasses import dataclass

from drivers.packets import MAX_ID, Status
from drivers.probe import BaudRefused, Heard, Probe, Setting
from drivers.serial_ports import DEFAULT_LATENCY_MS
from drivers.servo_models import MODELS, ServoModel, load_model, model_by_number
from drivers.status_errors import alarm_bits

ALL_IDS: tuple[int, ...] = tuple(range(MAX_ID + 1))
FACTORY_BAUDS = (1_000_000, 57_600)  # of AX, and of MX and X (e-manual, Baud Rate)
DEFAULT_LATENCY_S = DEFAULT_LATENCY_MS / 1000
# Up to so many ids are pinged one by one as well in protocol 2.0: a broadcast ping is answered by many at once.
SINGLE_PINGS = 32
PATIENCE = 4.0  # a doubtful id is given so many times the usual time to answer
ATTEMPTS = 3  # of a question to a servo that is there
_NUMBER_BYTES = 2


@dataclass(frozen=True, slots=True)
class Found:
    """A servo that answered.

    Attributes:
        model_number: None if it tells none (protocol 1.0, and it answers no reads), or only damaged replies came.
        firmware: None where it isn't known, or isn't told.
        answers_reads: whether it answers more than pings (Status Return Level 1 or 2).
        alarms: names of its error bits.
        asked, damaged, doubled: questions put to it; those whose reply was damaged; those that were answered twice.
    """

    servo_id: int
    setting: Setting
    model_number: int | None
    firmware: int | None
    answers_reads: bool
    alarms: tuple[str, ...]
    asked: int
    damaged: int
    doubled: int

    @property
    def model(self) -> ServoModel | None:
        """Its model, None for one whose control table isn't here."""
        return None if self.model_number is None else model_by_number(self.model_number)

    @property
    def shared(self) -> bool:
        """Whether it seems that several servos have this id: two replies to a question, or replies that collide."""
        return self.doubled > 0 or self.damaged > 1


@dataclass(frozen=True, slots=True)
class Step:
    """How far a scan has come, in seconds of waiting; what it asks now."""

    done_s: float
    total_s: float
    setting: Setting


@dataclass(frozen=True, slots=True)
class Skipped:
    """A setting that the port can't be set to, and why."""

    setting: Setting
    why: str


Event = Found | Step | Skipped  # what a scan tells of


def known_settings(*, first: Sequence[Setting] = ()) -> list[Setting]:
    """All that a known model can be set to: `first`, the factory's bauds, then the rest, the quick protocol 2.0 first.

    In either protocol the bauds that more models have come earlier.
    """
    counts: dict[Setting, int] = {}
    for name in MODELS:
        model = load_model(name)
        for protocol in model.protocols:
            for baud in model.baud_codes.values():
                counts[Setting(protocol, baud)] = counts.get(Setting(protocol, baud), 0) + 1

    def rank(setting: Setting) -> tuple[bool, float, int, int]:
        return setting.baud not in FACTORY_BAUDS, -setting.protocol, -counts[setting], -setting.baud

    return [*first, *sorted((setting for setting in counts if setting not in first), key=rank)]


def scan(
    port: str,
    settings: Sequence[Setting],
    ids: Sequence[int] = ALL_IDS,
    *,
    expected: Collection[int] = (),
    latency_s: float = DEFAULT_LATENCY_S,
) -> Generator[Event]:
    """Ask for servos at each setting in turn; yields what is found as it is found, and how far the scan has come.

    Protocol 1.0: a ping to each id. Protocol 2.0: a broadcast ping; single pings where damaged replies came back, to
    the expected ids, and to all if they are few. Close the iterator to let go of the port.

    Args:
        ids: to look for, in this order.
        expected: ids among them that are asked first.
        latency_s: of the adapter.

    Raises:
        NoPort: the port isn't there, or is held by another program.
        BusLost: the port vanished.
    """
    order = sorted(ids, key=lambda servo_id: servo_id not in expected)
    costs = [_cost_s(Probe(port, setting, latency_s=latency_s), order, expected) for setting in settings]
    total_s, done_s = sum(costs), 0.0
    for setting, cost_s in zip(settings, costs, strict=True):
        yield Step(done_s, total_s, setting)
        try:
            with Probe(port, setting, latency_s=latency_s) as probe:
                for event in _scan_setting(probe, order, expected):
                    yield event if isinstance(event, Found) else Step(done_s + event * cost_s, total_s, setting)
        except BaudRefused as error:
            yield Skipped(setting, str(error))
        done_s += cost_s
    if settings:
        yield Step(total_s, total_s, settings[-1])


def _scan_setting(probe: Probe, ids: Sequence[int], expected: Collection[int]) -> Iterator[Found | float]:
    """Servos at one setting, and the share of the work that is done."""
    candidates: set[int] = set()
    singles = ids
    if probe.setting.protocol == 2.0:
        heard = probe.ping_all()
        candidates = {status.servo_id for status in heard.statuses} & set(ids)
        yield from (identify(probe, servo_id) for servo_id in sorted(candidates))
        if not heard.stray_bytes:
            singles = _worth_asking(ids, expected)
    doubtful: set[int] = set()
    before: int | None = None
    for done, servo_id in enumerate(singles):
        if servo_id not in candidates:
            heard = probe.ping(servo_id)
            answered = {status.servo_id for status in heard.statuses} & set(ids) - candidates
            yield from (identify(probe, found) for found in sorted(answered))
            candidates |= answered
            if heard.stray_bytes:  # damaged, or too late an answer to the ping before
                doubtful |= {servo_id} if before is None else {servo_id, before}
        before = servo_id
        yield (done + 1) / len(singles)
    for servo_id in sorted(doubtful - candidates):
        if any(not probe.ping(servo_id, patience=PATIENCE).silent for _ in range(ATTEMPTS)):
            yield identify(probe, servo_id)


def _worth_asking(ids: Sequence[int], expected: Collection[int]) -> Sequence[int]:
    """Ids that get a ping of their own beside the broadcast."""
    return ids if len(ids) <= SINGLE_PINGS else [servo_id for servo_id in ids if servo_id in expected]


def _cost_s(probe: Probe, ids: Sequence[int], expected: Collection[int]) -> float:
    """About how long a setting takes if nothing is there."""
    if probe.setting.protocol == 1.0:
        return len(ids) * probe.reply_s
    return probe.broadcast_s + len(_worth_asking(ids, expected)) * probe.reply_s


class _Interview:
    """Questions to one servo, and how they were answered."""

    def __init__(self, probe: Probe, servo_id: int) -> None:
        self._probe, self._id = probe, servo_id
        self.asked = self.damaged = self.doubled = 0
        self.last: Status | None = None

    def ping(self) -> Status | None:
        """The reply to a ping, tried as often as it takes within ATTEMPTS."""
        return self._answer(lambda: self._probe.ping(self._id, patience=PATIENCE))

    def read(self, address: int, size: int) -> bytes | None:
        """Bytes of the control table; None if none come."""
        status = self._answer(lambda: self._probe.read(self._id, address, size, patience=PATIENCE), size)
        return None if status is None else status.parameters

    def _answer(self, ask: Callable[[], Heard], size: int | None = None) -> Status | None:
        for _ in range(ATTEMPTS):
            heard = ask()
            self.asked += 1
            statuses = heard.of(self._id)
            self.damaged += heard.stray_bytes > 0
            self.doubled += len(statuses) > 1
            fitting = [status for status in statuses if size is None or len(status.parameters) == size]
            if fitting:
                self.last = fitting[0]
                return fitting[0]
        return None


def identify(probe: Probe, servo_id: int) -> Found:
    """What a servo that is there tells of itself: model, firmware, alarms, and whether it is alone with its id."""
    interview = _Interview(probe, servo_id)
    ping = interview.ping()
    number = interview.read(0, _NUMBER_BYTES)
    firmware: int | None = None
    model_number = None if number is None else int.from_bytes(number, "little")
    if probe.setting.protocol == 2.0 and ping is not None and len(ping.parameters) == 3:
        told = int.from_bytes(ping.parameters[:2], "little")
        model_number, firmware = told if model_number is None else model_number, ping.parameters[2]
    model = None if model_number is None else model_by_number(model_number)
    alarms: tuple[str, ...] = ()
    if model is not None and number is not None:
        if firmware is None and (data := _register(interview, model, "firmware_version")) is not None:
            firmware = data
        for _ in range(2):  # servos that share an id and a model differ in where they stand: their replies collide
            _register(interview, model, "present_position")
        alarms = _alarms(interview, model, probe.setting.protocol)
    return Found(
        servo_id, probe.setting, model_number, firmware, number is not None, alarms,
        interview.asked, interview.damaged, interview.doubled,
    )  # fmt: skip


def _register(interview: _Interview, model: ServoModel, name: str) -> int | None:
    register = model.register(name)
    data = interview.read(register.address, register.size)
    return None if data is None else register.decode(data)


def _alarms(interview: _Interview, model: ServoModel, protocol: float) -> tuple[str, ...]:
    bits = 0 if interview.last is None else alarm_bits(interview.last.error, protocol)
    if not bits:
        return ()
    if model.hardware_error_register is None:
        return model.error_names(bits)
    return model.error_names(_register(interview, model, model.hardware_error_register) or 0) or ("alert",)
