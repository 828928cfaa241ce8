"""Faults as text: what is read is what was written, and what can never happen is refused."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.emulator import Fault, format_fault, parse_fault
from drivers.emulator.fault_schedule import FaultSchedule, wired_and
from drivers.emulator.faults import KINDS
from drivers.errors import DriverError
from drivers.servo_models import load_model

FINITE = st.floats(allow_nan=False, allow_infinity=False)
POSITIVE = st.floats(min_value=0, exclude_min=True, allow_infinity=False)
VALUES = {
    "delay": POSITIVE,
    "noise": st.none() | st.integers(1, 99),
    "alert": st.sampled_from(["overload", "input_voltage"]),
    "status_level": st.integers(0, 2),
    "baud": st.integers(1, 10_000_000),
    "voltage": POSITIVE,
    "temperature": FINITE,
    "obstruct": st.tuples(FINITE, FINITE).map(lambda ends: (min(ends), max(ends))) | st.floats(0, 1e9),
}


@st.composite
def faults(draw: st.DrawFn) -> Fault:
    kind = draw(st.sampled_from(sorted(KINDS)))
    ids = st.none() | st.lists(st.integers(0, 252), min_size=1, unique=True).map(tuple)
    return Fault(
        kind,
        None if kind == "unplug" else draw(ids),
        draw(st.floats(0, allow_infinity=False)),
        draw(POSITIVE | st.just(math.inf)) if KINDS[kind].ends else math.inf,
        draw(st.floats(0, 1, exclude_min=True)),
        draw(VALUES.get(kind, st.none())),
    )


@given(faults())
def test_a_fault_reads_back_from_its_own_line(fault: Fault) -> None:
    assert parse_fault(format_fault(fault)) == fault


@given(st.text() | st.text(alphabet="mutedlay:,@+%=.0123456789-e"))
def test_any_text_is_a_fault_or_an_error_of_the_drivers(text: str) -> None:
    try:
        parse_fault(text)
    except DriverError:
        return


def test_the_line_of_the_manual_means_what_it_says() -> None:
    fault = parse_fault("delay:2,3@1.5+10%0.1=0.05")
    assert fault == Fault("delay", (2, 3), at_s=1.5, for_s=10.0, rate=0.1, value=0.05)
    assert parse_fault("obstruct:2@1=-10..20.5") == Fault("obstruct", (2,), at_s=1.0, value=(-10.0, 20.5))
    assert parse_fault("mute") == Fault("mute")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("mte:2", "no fault kind 'mte'; there are mute, delay, bad_crc"),
        ("mute 2", r"'mute 2' is no fault; want kind\[:ids\]"),
        ("mute@-1", "starts at -1 s; want 0 or later"),
        ("mute+0", "lasts 0 s; want more than 0"),
        ("mute%0", "rate 0; want more than 0, at most 1"),
        ("mute%1.5", "rate 1.5; want more than 0, at most 1"),
        ("mute:300", "has id 300; want 0 to 252"),
        ("mute:2,2", r"has ids \[2, 2\]; want each once"),
        ("unplug:3", "befalls the whole bus; leave the ids out"),
        ("delay", "want a value: s"),
        ("delay=soon", "want a value: s; have soon"),
        ("mute=3", "takes no value; have 3"),
        ("status_level=3", "0, 1 or 2; have 3"),
        ("obstruct=20..10", "have"),
        ("alert=overload", None),
        ("alert:2+3=overload", "has no end of its own; leave the duration out"),
    ],
)
def test_a_fault_that_can_never_happen_is_refused(text: str, said: str | None) -> None:
    if said is None:
        parse_fault(text)
        return
    with pytest.raises(DriverError, match=said):
        parse_fault(text)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("mute:9", "no servo 9 on this bus; it has 1, 2"),
        ("alert:1=warmth", "AX-18A has no alarm 'warmth'; it has input_voltage"),
        ("baud:2=250000", "XM430-W350 has no baud 250000; it has"),
        ("alert=warmth", "no alarm 'warmth'"),
    ],
)
def test_a_fault_that_this_bus_can_not_have_is_refused(text: str, said: str) -> None:
    models = {1: load_model("AX-18A"), 2: load_model("XM430-W350")}
    with pytest.raises(DriverError, match=said):
        FaultSchedule([parse_fault(text)], models, seed=0, start_ns=0)


def test_one_fault_more_does_not_change_what_the_others_draw() -> None:
    models = {1: load_model("AX-18A")}

    def drawn(*texts: str) -> list[bool]:
        schedule = FaultSchedule(list(map(parse_fault, texts)), models, seed=5, start_ns=0)
        return [schedule.mutes(1, 0) for _ in range(200)]

    alone = drawn("mute%0.3")
    assert drawn("mute%0.3", "delay%0.5=1") == alone
    assert 30 < sum(alone) < 90  # 60 expected, six standard deviations about


def test_two_faults_alike_do_not_strike_alike() -> None:
    models = {1: load_model("AX-18A"), 2: load_model("AX-18A")}
    schedule = FaultSchedule([parse_fault("mute:1%0.5"), parse_fault("mute:2%0.5")], models, seed=5, start_ns=0)
    struck = [(schedule.mutes(1, 0), schedule.mutes(2, 0)) for _ in range(100)]
    assert 20 < sum(first == second for first, second in struck) < 80


def test_two_senders_pull_the_line_low_together() -> None:
    assert wired_and(b"\xf0\x3c", b"\xf0\x3c", 0) == b"\xf0\x3c"
    assert wired_and(b"\xf0", b"\x3c", 0) == b"\x30"
    # 0xFF is a start bit and nine bits high. The second start bit, two bits later, pulls data bit 1 low.
    assert wired_and(b"\xff", b"\xff", 2) == b"\xfd"
