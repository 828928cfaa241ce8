"""The driver on a bus that misbehaves: does it ever believe a wrong value, hang, or leave something behind?

    python -m tests.benchmarks.fault_campaign [--transactions 100000] [--unplugs 200] [--seed 0]

Transactions: single reads, group reads, writes and sync writes of six servos, in each protocol, while one reply in ten
is corrupted, truncated, late, echoed, another servo's or behind noise. What every register holds is known: each value
that the driver returns is checked. Unplugs: the device vanishes at a random moment while two threads use the bus.
"""

from __future__ import annotations

import argparse
import threading
import time
from collections import Counter
from dataclasses import dataclass, field

import numpy as np

from drivers.clock import MonotonicClock
from drivers.dynamixel import DynamixelBus
from drivers.emulator import EmulatedBus, EmulatedServo, Fault
from drivers.errors import CorruptReply, NoReply
from tests.conftest import open_files

IDS = tuple(range(1, 7))
MODELS = {1.0: "MX-28", 2.0: "XM430-W350"}
BAUD = 1_000_000
REPLY_TIMEOUT_S = 0.010
LATE_S = 0.015  # later than the driver waits
# A tenth of the replies; each kind is drawn by itself.
RATES = {
    "corrupt": 0.02,
    "truncate": 0.015,
    "delay": 0.015,
    "echo": 0.015,
    "stray": 0.01,
    "wrong_id": 0.01,
    "noise": 0.015,
}
# Registers whose value nothing but a write changes, with the greatest value that is written.
REGISTERS = {
    1.0: {"led": 1, "goal_position": 4095, "torque_limit": 1023, "moving_speed": 1023},
    2.0: {"led": 1, "goal_position": 4095, "profile_velocity": 32767, "profile_acceleration": 32767, "goal_pwm": 885},
}


@dataclass
class Tally:
    """What came of the transactions."""

    done: Counter[str] = field(default_factory=Counter)
    wrong: list[str] = field(default_factory=list)
    given_up: int = 0
    slowest_s: float = 0.0


class Known:
    """What each register may hold: one value, or two after a write that nobody confirmed."""

    def __init__(self, protocol: float) -> None:
        self._values: dict[tuple[int, str], set[int]] = {}
        self.registers = REGISTERS[protocol]

    def wrote(self, servo_id: int, register: str, value: int, *, sure: bool) -> None:
        old = set() if sure else self._values.get((servo_id, register), set())
        self._values[servo_id, register] = {*old, value}

    def check(self, servo_id: int, register: str, value: int) -> str | None:
        """What is wrong with a value that was read, None if nothing is."""
        allowed = self._values[servo_id, register]
        self._values[servo_id, register] = {value} if value in allowed else allowed
        return None if value in allowed else f"servo {servo_id}, {register}: read {value}, holds {sorted(allowed)}"


def transact(bus: DynamixelBus, known: Known, rng: np.random.Generator, tally: Tally) -> None:
    """One transaction of a random kind."""
    register = str(rng.choice([*known.registers]))
    most = known.registers[register]
    one, some = int(rng.choice(IDS)), sorted(int(id) for id in rng.permutation(IDS)[: rng.integers(2, 7)])
    kind = str(rng.choice(["read", "group read", "write", "sync write"], p=[0.35, 0.3, 0.2, 0.15]))
    tally.done[kind] += 1
    try:
        if kind == "read":
            _judge(tally, known.check(one, register, bus.read(one, register)))
        elif kind == "group read":
            for servo_id, reading in bus.read_many(some, register).items():
                _judge(tally, known.check(servo_id, register, reading.value))
        elif kind == "write":
            value = int(rng.integers(0, most + 1))
            known.wrote(one, register, value, sure=False)
            bus.write(one, register, value)
            known.wrote(one, register, value, sure=True)
        else:
            values = {servo_id: int(rng.integers(0, most + 1)) for servo_id in some}
            bus.sync_write(register, values)
            for servo_id, value in values.items():
                known.wrote(servo_id, register, value, sure=True)
    except (NoReply, CorruptReply):
        tally.given_up += 1


def _judge(tally: Tally, wrong: str | None) -> None:
    if wrong is not None:
        tally.wrong.append(wrong)


def campaign(protocol: float, transactions: int, seed: int) -> tuple[Tally, dict[str, int], float]:
    """(tally, the driver's own counts, seconds) of so many transactions on a misbehaving bus."""
    servos = [EmulatedServo(id, MODELS[protocol]) for id in IDS]
    for servo in servos:
        servo.set("return_delay_time", 0)
    calm_s = 3.0  # no faults while the registers get their first values
    faults = [
        Fault(kind, at_s=calm_s, rate=rate, value=LATE_S if kind == "delay" else None) for kind, rate in RATES.items()
    ]
    clock, rng, tally = MonotonicClock(), np.random.default_rng(seed), Tally()
    with (
        EmulatedBus(servos, baud=BAUD, clock=clock, faults=faults, seed=seed) as emulated,
        DynamixelBus(emulated.path, baud=BAUD, protocol=protocol, clock=clock, reply_timeout_s=REPLY_TIMEOUT_S) as bus,
    ):
        start_s, known = time.monotonic(), Known(protocol)
        for servo_id in IDS:
            for register in known.registers:
                bus.write(servo_id, register, 0)
                known.wrote(servo_id, register, 0, sure=True)
        time.sleep(max(0.0, start_s + calm_s - time.monotonic()))
        begin_s = time.monotonic()
        for _ in range(transactions):
            t_s = time.monotonic()
            transact(bus, known, rng, tally)
            tally.slowest_s = max(tally.slowest_s, time.monotonic() - t_s)
        return tally, bus.errors, time.monotonic() - begin_s


def unplugs(protocol: float, times: int, seed: int) -> tuple[Counter[str], int]:
    """(what each of two threads met when the device vanished, threads and descriptors left behind) in `times` goes."""
    rng = np.random.default_rng(seed)
    clock, met = MonotonicClock(), Counter[str]()
    with EmulatedBus([EmulatedServo(id, MODELS[protocol]) for id in IDS], baud=BAUD, clock=clock) as emulated:
        before = threading.active_count(), len(open_files())

        def use(bus: DynamixelBus, losses: list[str]) -> None:
            try:
                while True:
                    bus.read_many(IDS, "present_position")
                    bus.read(IDS[0], "led")
            except BaseException as error:  # whatever it is, it is counted
                losses.append(type(error).__name__)

        for _ in range(times):
            losses: list[str] = []
            # Patient: a stalled machine must not look like a servo that is silent.
            with DynamixelBus(emulated.path, baud=BAUD, protocol=protocol, clock=clock, reply_timeout_s=5.0) as bus:
                users = [threading.Thread(target=use, args=(bus, losses)) for _ in range(2)]
                for user in users:
                    user.start()
                time.sleep(float(rng.uniform(0.001, 0.05)))
                emulated.unplug()
                for user in users:
                    user.join()
            met[" + ".join(sorted(losses))] += 1
            emulated.replug()
        with DynamixelBus(emulated.path, baud=BAUD, protocol=protocol, clock=clock) as bus:
            bus.read_many(IDS, "present_position")
        left = threading.active_count() - before[0] + len(open_files()) - before[1]
    return met, left


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--transactions", type=int, default=100_000, help="of each protocol")
    parser.add_argument("--unplugs", type=int, default=200, help="of each protocol")
    parser.add_argument("--seed", type=int, default=0)
    chosen = parser.parse_args()
    for protocol, model in MODELS.items():
        tally, errors, seconds = campaign(protocol, chosen.transactions, chosen.seed)
        print(f"protocol {protocol}, {len(IDS)} {model}: {chosen.transactions} transactions in {seconds:.0f} s")
        print(f"  {', '.join(f'{count} {kind}s' for kind, count in tally.done.items())}")
        print(f"  wrong values {len(tally.wrong)}, given up {tally.given_up}, slowest {tally.slowest_s:.2f} s")
        print(f"  the driver's counts: {', '.join(f'{name} {count}' for name, count in errors.items())}")
        for line in tally.wrong[:5]:
            print(f"    {line}")
        met, left = unplugs(protocol, chosen.unplugs, chosen.seed)
        print(f"  unplugged {chosen.unplugs} times: {dict(met)}; left behind {left}")


if __name__ == "__main__":
    main()
