"""Checks of the serial port: it is there, may be opened, is nobody else's, and doesn't hold replies back."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

from drivers.serial_ports import (
    DEV,
    PROC,
    SYS,
    User,
    describe_holders,
    describe_ports,
    find_access,
    find_holders,
    latency_file,
    read_latency_ms,
)
from station.doctor.finding import Finding, Verdict

WHERE = "port"
WANTED_LATENCY_MS = 1
# linux/drivers/usb/serial/ftdi_sio.c registers the attribute on the usb-serial device.
UDEV_RULE = 'ACTION=="add", SUBSYSTEM=="usb-serial", DRIVER=="ftdi_sio", ATTR{latency_timer}="1"'
UDEV_FILE = "/etc/udev/rules.d/99-dynamixel-latency.rules"


@dataclass(frozen=True)
class System:
    """Where the system shows its devices, programs and drivers; made ones in tests."""

    dev: Path = DEV
    proc: Path = PROC
    sys: Path = SYS


def check_port(port: str, user: User, system: System) -> list[Finding]:
    """All that can be known of a port without opening it."""
    if not Path(port).exists():
        mend = f"plug in the adapter, or correct 'port' under [bus] in the rig; {describe_ports(system.dev)}"
        return [Finding(WHERE, "exists", Verdict.BLOCKS, f"there is no {port}", mend, {"port": port})]
    there = Finding(WHERE, "exists", Verdict.OK, f"{port} is there", values={"port": port}, brief=port)
    return [there, check_access(port, user), check_holders(port, system), check_latency(port, system)]


def check_access(port: str, user: User) -> Finding:
    """Whether the user may read and write the port."""
    access = find_access(port, user)
    mine = user == User.of_this_program()
    if access.allowed or (mine and os.access(port, os.R_OK | os.W_OK)):  # an access list may allow more
        found, verdict, mend = f"{user.name} may open it", Verdict.OK, ""
    elif access.listed:
        found, verdict = f"{user.name} is in group {access.group}, but not yet in this login", Verdict.BLOCKS
        mend = f"log out and in again, or: newgrp {access.group}"
    else:
        found, verdict = f"{user.name} may not open it: not in group {access.group}", Verdict.BLOCKS
        mend = f"sudo usermod -aG {access.group} {user.name}, then log out and in again"
    values = {"user": user.name, "group": access.group, "allowed": verdict is Verdict.OK}
    return Finding(WHERE, "permission", verdict, found, mend, values)


def check_holders(port: str, system: System) -> Finding:
    """Whether another program has the port open."""
    holders = find_holders(port, system.proc)
    values = {"held_by_pids": [str(holder.pid) for holder in holders]}
    if not holders:
        return Finding(WHERE, "held by", Verdict.OK, "no other program that can be seen has it open", values=values)
    mend = f"close {describe_holders(holders)}"
    pids = ", ".join(f"pid {holder.pid} ({Path(holder.command.split()[0]).name})" for holder in holders)
    return Finding(WHERE, "held by", Verdict.BLOCKS, pids, mend, values)


def check_latency(port: str, system: System) -> Finding:
    """Whether an FTDI adapter keeps replies back: 16 ms as it comes, and each exchange takes as long."""
    latency_ms = read_latency_ms(port, system.sys)
    values = {"latency_timer_ms": latency_ms}
    if latency_ms is None:
        return Finding(WHERE, "latency timer", Verdict.OK, "has none (no FTDI adapter)", values=values)
    if latency_ms <= WANTED_LATENCY_MS:
        brief = f"latency timer {latency_ms} ms"
        return Finding(WHERE, "latency timer", Verdict.OK, brief, values=values, brief=brief)
    found = f"{latency_ms} ms: at most {1000 // latency_ms} exchanges a second"
    now = f"echo {WANTED_LATENCY_MS} | sudo tee {latency_file(port, system.sys)}"
    mend = f"for now: {now}\nfor good, a line in {UDEV_FILE}, then plug the adapter in again:\n{UDEV_RULE}"
    return Finding(WHERE, "latency timer", Verdict.WARNING, found, mend, values)
