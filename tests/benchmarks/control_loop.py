"""How much processor a control loop takes, and how near its rate comes to what the wire allows.

Six servos: each turn a sync write of all goals and a read of every servo's whole status (position, speed, load or
current, voltage, temperature). The emulated bus runs in a process of its own: what is measured is the station's side.

    python -m tests.benchmarks.control_loop
"""

from __future__ import annotations

import argparse
import multiprocessing
import time
from multiprocessing.connection import Connection

import numpy as np

from drivers.arm import Arm
from drivers.clock import MonotonicClock
from drivers.dynamixel import DynamixelBus
from drivers.emulator import EmulatedBus, EmulatedServo
from drivers.joints import JointConfig, ServoConfig
from drivers.safety import SafetyLimits

IDS = range(1, 7)
RATE_HZ = 100.0
RUNS = 5
MODELS = (("XM430-W350", 2.0), ("MX-28", 1.0), ("AX-18A", 1.0))
BAUDS = (57_600, 1_000_000, 3_000_000)
# Bytes on the wire of a turn: sync write, then the read (e-manual, packets of either protocol).
_BITS = 10


def serve(model: str, protocol: float, baud: int, return_delay_us: int, pipe: Connection) -> None:
    """The other process: an emulated bus until the pipe says otherwise."""
    delay = {"return_delay_time": return_delay_us // 2}
    servos = [EmulatedServo(id, model, protocol=protocol, eeprom=delay) for id in IDS]
    with EmulatedBus(servos, baud=baud, clock=MonotonicClock()) as bus:
        pipe.send(bus.path)
        pipe.recv()


def wire_s(model: str, protocol: float, baud: int, return_delay_us: int) -> float:
    """Time that a turn's bytes and the servos' return delays take on the wire."""
    table = EmulatedServo(1, model).model
    registers = [table.registers[name] for name in table.status_registers]
    size = max(r.address + r.size for r in registers) - min(r.address for r in registers)
    goal = table.registers["goal_position"].size
    count = len(IDS)
    if protocol == 2.0:  # sync write; sync read and a reply each
        wire_bytes = 14 + count * (goal + 1) + 14 + count + count * (11 + size)
    elif table.bulk_read:
        wire_bytes = 8 + count * (goal + 1) + 7 + 3 * count + count * (6 + size)
    else:
        wire_bytes = 8 + count * (goal + 1) + count * (8 + 6 + size)
    return wire_bytes * _BITS / baud + count * return_delay_us * 1e-6


def _path(pipe: Connection) -> str:
    """The emulated bus's device; raises EOFError if the other process ended."""
    return str(pipe.recv())


def run(model: str, protocol: float, baud: int, return_delay_us: int, seconds: float, rate_hz: float | None) -> tuple:
    """(turns/s, share of a core, errors mended) of a loop at `rate_hz`, or as fast as it goes."""
    here, there = multiprocessing.Pipe()
    other = multiprocessing.get_context("spawn").Process(
        target=serve, args=(model, protocol, baud, return_delay_us, there)
    )
    other.start()
    there.close()  # so that the end of the other process is noticed
    clock = MonotonicClock()
    joints = [JointConfig(f"joint{id}", (ServoConfig(id, model),), -1.5, 1.5, 1.0) for id in IDS]
    with DynamixelBus(_path(here), baud=baud, protocol=protocol, clock=clock) as bus:
        arm = Arm(bus, joints, clock, limits=SafetyLimits(stall_s=0.0))
        arm.connect()
        arm.torque_on()
        start_s, start_cpu_s, turns = time.monotonic(), time.process_time(), 0
        while (now_s := time.monotonic() - start_s) < seconds:
            arm.command(np.full(len(joints), 0.5 * np.sin(now_s)))
            arm.read()
            turns += 1
            if rate_hz is not None:
                time.sleep(max(0.0, start_s + turns / rate_hz - time.monotonic()))
        wall_s, cpu_s = time.monotonic() - start_s, time.process_time() - start_cpu_s
        errors = sum(bus.errors.values())
        arm.torque_off()
    here.send(None)
    other.join()
    return turns / wall_s, cpu_s / wall_s, errors


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=5.0, help="of each run")
    seconds = parser.parse_args().seconds
    print(f"at {RATE_HZ:g} Hz, 1 Mbaud, return delay 0: share of one core on the station's side")
    print(f"{'model':12} {'turns/s':>8} {'least %':>8} {'median':>7} {'most':>7} {'mended':>7}   ({RUNS} runs)")
    for model, protocol in MODELS:
        runs = [run(model, protocol, 1_000_000, 0, seconds, RATE_HZ) for _ in range(RUNS)]
        core = sorted(100 * share for _, share, _ in runs)
        row = f"{core[0]:8.1f} {core[RUNS // 2]:7.1f} {core[-1]:7.1f} {sum(errors for _, _, errors in runs):7d}"
        print(f"{model:12} {np.median([rate for rate, _, _ in runs]):8.1f} {row}")
    print("\nas fast as it goes, against what the wire allows")
    print(f"{'model':12} {'baud':>8} {'delay us':>8} {'turns/s':>8} {'wire':>8} {'share %':>8} {'mended':>7}")
    for model, protocol in MODELS:
        for baud in BAUDS:
            if baud not in EmulatedServo(1, model).model.baud_codes.values():
                continue
            for delay_us in (0, 500):
                rate, _, errors = run(model, protocol, baud, delay_us, seconds, None)
                limit = 1 / wire_s(model, protocol, baud, delay_us)
                share = 100 * rate / limit
                print(f"{model:12} {baud:8d} {delay_us:8d} {rate:8.1f} {limit:8.1f} {share:8.1f} {errors:7d}")


if __name__ == "__main__":
    main()
