"""A scan finds what is on a wire, says what is odd about it, and changes nothing."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import closing, contextmanager

import pytest

from drivers.clock import VirtualClock
from drivers.dynamixel import DynamixelBus
from drivers.emulator import EmulatedBus, EmulatedServo
from drivers.emulator.bus import AlterReply
from drivers.errors import BusLost, NoPort
from drivers.probe import Probe, Setting
from drivers.scan import ALL_IDS, FACTORY_BAUDS, Found, Skipped, Step, known_settings, scan
from drivers.servo_models import MODELS, load_model

AX = Setting(1.0, 1_000_000)
X = Setting(2.0, 1_000_000)
PATIENT_S = 0.1  # for replies that come: a stalled machine must not fail a test
BOTH = pytest.mark.parametrize(("model", "setting"), [("AX-18A", AX), ("XM430-W350", X)])


@contextmanager
def wire(
    servos: Sequence[EmulatedServo], setting: Setting, alter_reply: AlterReply | None = None
) -> Iterator[EmulatedBus]:
    with EmulatedBus(servos, baud=setting.baud, clock=VirtualClock(), alter_reply=alter_reply) as bus:
        yield bus


def found_on(
    bus: EmulatedBus, settings: Sequence[Setting], ids: Sequence[int], expected: Sequence[int] = ()
) -> list[Found]:
    events = scan(bus.path, settings, ids, expected=expected, latency_s=PATIENT_S)
    return [event for event in events if isinstance(event, Found)]


def set_baud(servo: EmulatedServo, baud: int) -> None:
    servo.set("baud_rate", next(code for code, known in servo.model.baud_codes.items() if known == baud))


@BOTH
def test_servos_are_found_with_model_and_firmware(model: str, setting: Setting):
    servos = [EmulatedServo(id, model) for id in (1, 3)]
    servos[1].set("firmware_version", 45)
    with wire(servos, setting) as bus:
        found = found_on(bus, [setting], range(5))
    assert [(f.servo_id, f.model_number, f.firmware) for f in found] == [
        (1, load_model(model).model_number, 0),
        (3, load_model(model).model_number, 45),
    ]
    assert all(f.model is load_model(model) and f.answers_reads and not f.shared and not f.alarms for f in found)
    assert all(f.setting == setting for f in found)


@BOTH
def test_a_servo_at_another_baud_is_found_there(model: str, setting: Setting):
    servos = [EmulatedServo(id, model) for id in (1, 2)]
    other = Setting(setting.protocol, 57_600)
    with wire(servos, setting) as bus:
        set_baud(servos[1], 57_600)
        found = found_on(bus, [setting, other], range(1, 4))
    assert [(f.servo_id, f.setting) for f in found] == [(1, setting), (2, other)]


@BOTH
def test_a_servo_that_answers_pings_alone_is_found(model: str, setting: Setting):
    servo = EmulatedServo(2, model)
    with wire([servo], setting) as bus:
        servo.set("status_return_level", 0)
        (found,) = found_on(bus, [setting], range(1, 4))
    assert found.servo_id == 2 and not found.answers_reads
    # protocol 2.0 tells the model in the reply to a ping
    assert found.model_number == (None if setting is AX else 1020)


@BOTH
def test_a_servo_with_an_alarm_is_found_with_it(model: str, setting: Setting):
    with wire([EmulatedServo(1, model)], setting) as bus:
        bus.raise_alarm(1, "overheating")
        (found,) = found_on(bus, [setting], [1])
    assert found.alarms == ("overheating",)


def test_all_protocols_and_bauds_on_one_wire_are_found():
    servos = [EmulatedServo(1, "AX-18A"), EmulatedServo(11, "XM430-W350"), EmulatedServo(5, "MX-28(2.0)")]
    settings = [Setting(1.0, 57_600), AX, Setting(2.0, 57_600), X]
    with EmulatedBus(servos, clock=VirtualClock()) as bus:
        found = found_on(bus, settings, [1, 5, 11])
    assert {(f.servo_id, f.setting, f.model.name if f.model else "") for f in found} == {
        (1, AX, "AX-18A"),
        (5, Setting(2.0, 57_600), "MX-28(2.0)"),
        (11, Setting(2.0, 57_600), "XM430-W350"),
    }


def test_a_model_without_a_control_table_is_found_by_its_number():
    servo = EmulatedServo(1, "XM430-W350")
    servo.set("model_number", 4711)
    with wire([servo], X) as bus:
        (found,) = found_on(bus, [X], [1])
    assert found.model_number == 4711 and found.model is None


def twice(servo_id: int, reply: bytes) -> Iterable[tuple[int, bytes]]:
    return [(0, reply), (0, reply)]


def colliding(servo_id: int, reply: bytes) -> Iterable[tuple[int, bytes]]:
    return [(0, reply[:-2] + bytes(byte ^ 0x55 for byte in reply[-2:]))]


@BOTH
@pytest.mark.parametrize("alter", [twice, colliding])
def test_servos_that_share_an_id_are_said_to(model: str, setting: Setting, alter: AlterReply):
    with wire([EmulatedServo(1, model)], setting, alter) as bus:
        (found,) = found_on(bus, [setting], [0, 1, 2])
    assert found.servo_id == 1 and found.shared


@BOTH
def test_one_damaged_reply_is_no_shared_id(model: str, setting: Setting):
    replies: list[bytes] = []

    def third(servo_id: int, reply: bytes) -> Iterable[tuple[int, bytes]]:
        replies.append(reply)
        return [(0, reply[:-1] if len(replies) == 3 else reply)]

    with wire([EmulatedServo(1, model)], setting, third) as bus:
        (found,) = found_on(bus, [setting], [1])
    assert found.damaged == 1 and found.model is load_model(model) and not found.shared


def test_single_pings_follow_where_the_broadcast_is_damaged():
    """The first reply to a broadcast of 40 ids is lost in noise: more ids than are pinged one by one as a rule."""
    pings: list[int] = []

    def noisy_once(servo_id: int, reply: bytes) -> Iterable[tuple[int, bytes]]:
        pings.append(servo_id)
        return [(0, b"\x00\xff\x12")] if len(pings) == 1 else [(0, reply)]

    with wire([EmulatedServo(id, "XM430-W350") for id in (3, 39)], X, noisy_once) as bus:
        events = scan(bus.path, [X], range(40), latency_s=0.03)
        found = {event.servo_id for event in events if isinstance(event, Found)}
    assert found == {3, 39}


def test_an_expected_servo_that_missed_the_broadcast_is_pinged():
    missed: list[int] = []

    def misses_once(servo_id: int, reply: bytes) -> Iterable[tuple[int, bytes]]:
        if not missed:
            missed.append(servo_id)
            return []
        return [(0, reply)]

    with wire([EmulatedServo(7, "XM430-W350")], X, misses_once) as bus:
        assert [f.servo_id for f in found_on(bus, [X], ALL_IDS, expected=[7])] == [7]


def test_a_reply_that_comes_too_late_is_not_lost():
    """An adapter with a slow latency timer: each reply to a ping comes while the next id is asked."""
    late: list[bytes] = []

    def one_late(servo_id: int, reply: bytes) -> Iterable[tuple[int, bytes]]:
        kept = [*late]
        late.append(reply)
        return [(0, kept.pop()), (0, reply)] if kept else []

    with wire([EmulatedServo(1, "AX-18A"), EmulatedServo(2, "AX-18A")], AX, one_late) as bus:
        assert {f.servo_id for f in found_on(bus, [AX], [1, 2, 3])} == {1, 2}


@BOTH
def test_an_adapter_that_sends_back_what_it_is_sent_finds_no_ghosts(model: str, setting: Setting):
    """On such an adapter all ids seem to answer pings in protocol 1.0: the ping itself reads as a status packet."""
    from drivers.packets import Instruction, encode_instruction

    pings = {id: encode_instruction(id, Instruction.PING, b"", setting.protocol) for id in range(4)}
    heard: list[int] = []

    def echo(servo_id: int, reply: bytes) -> Iterable[tuple[int, bytes]]:
        heard.append(servo_id)
        return [(0, pings[servo_id] + reply)]

    with (
        wire([EmulatedServo(2, model)], setting, echo) as bus,
        Probe(bus.path, setting, latency_s=PATIENT_S) as probe,
    ):
        answer = probe.ping(2)
    assert heard and len(answer.statuses) == 1 and not answer.stray_bytes


@BOTH
def test_a_scan_changes_no_register(model: str, setting: Setting):
    servo = EmulatedServo(1, model)
    with wire([servo], setting) as bus:
        before = {name: servo.get(name) for name, register in servo.model.registers.items() if register.writable}
        found_on(bus, [setting], range(3))
        after = {name: servo.get(name) for name in before}
    assert after == before


@BOTH
def test_a_scan_that_is_stopped_leaves_the_port_free(model: str, setting: Setting):
    with wire([EmulatedServo(1, model)], setting) as bus:
        with closing(scan(bus.path, [setting], ALL_IDS, latency_s=PATIENT_S)) as events:
            while not isinstance(next(events), Found):
                pass
        with DynamixelBus(bus.path, baud=setting.baud, protocol=setting.protocol, clock=VirtualClock()) as client:
            assert client.ping(1) == load_model(model).model_number


def test_a_probe_lets_go_of_its_port():
    with wire([EmulatedServo(1, "AX-18A")], AX) as bus:
        with Probe(bus.path, AX, latency_s=PATIENT_S) as probe:
            with pytest.raises(NoPort, match="held by another program"), Probe(bus.path, AX, latency_s=PATIENT_S):
                pass
            assert probe.ping(1).of(1)
        with Probe(bus.path, AX, latency_s=PATIENT_S) as other:  # while the first one is still referred to
            assert other.ping(1).of(1) and probe is not other


def test_progress_rises_to_the_whole():
    with wire([EmulatedServo(1, "AX-18A")], AX) as bus:
        events = list(scan(bus.path, [AX, X], range(4), latency_s=0.02))
    steps = [event for event in events if isinstance(event, Step)]
    shares = [step.done_s / step.total_s for step in steps]
    assert shares[0] == 0 and shares[-1] == 1 and shares == sorted(shares)
    assert {step.setting for step in steps} == {AX, X}


def test_a_baud_that_the_port_does_not_have_is_skipped():
    impossible = Setting(2.0, 2**40)
    with wire([EmulatedServo(1, "XM430-W350")], X) as bus:
        events = list(scan(bus.path, [impossible, X], [1], latency_s=PATIENT_S))
    assert [event.setting for event in events if isinstance(event, Skipped)] == [impossible]
    assert [event.servo_id for event in events if isinstance(event, Found)] == [1]


def test_a_port_that_is_not_there_is_an_error():
    with pytest.raises(NoPort, match="no port /dev/gone"):
        list(scan("/dev/gone", [X]))


def test_a_port_that_vanishes_is_one_error():
    with wire([EmulatedServo(1, "AX-18A")], AX) as bus:
        events = scan(bus.path, [AX], ALL_IDS, latency_s=0.02)
        while not isinstance(next(events), Found):
            pass
        bus.close()
        with pytest.raises(BusLost):
            list(events)


def test_all_settings_of_all_models_are_tried_the_likely_ones_first():
    settings = known_settings(first=[Setting(1.0, 250_000)])
    assert settings[0] == Setting(1.0, 250_000)
    assert {s.baud for s in settings[1:5]} == set(FACTORY_BAUDS)
    assert [s.protocol for s in settings[1:5]] == [2.0, 2.0, 1.0, 1.0]
    assert len(set(settings)) == len(settings)
    for name in MODELS:
        model = load_model(name)
        assert {Setting(p, baud) for p in model.protocols for baud in model.baud_codes.values()} <= set(settings)
