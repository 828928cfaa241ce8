"""What the system knows of its serial ports: which there are, who holds one, how long an adapter holds bytes back."""

from __future__ import annotations

import contextlib
import grp
import os
import pwd
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from drivers.errors import NoPort

DEV, PROC, SYS = Path("/dev"), Path("/proc"), Path("/sys")
# ms. What an FTDI adapter does unless told otherwise; a scan waits for replies of such a one.
DEFAULT_LATENCY_MS = 16
_MASTERS = {"/dev/ptmx", "/dev/pts/ptmx"}


@dataclass(frozen=True, slots=True)
class Holder:
    """A program that has a port open."""

    pid: int
    command: str


@dataclass(frozen=True, slots=True)
class User:
    """Who wants to open a port: the user and the groups of this login."""

    name: str
    uid: int
    groups: frozenset[int]

    @classmethod
    def of_this_program(cls) -> User:
        """The user that runs this program."""
        uid = os.geteuid()
        try:
            name = pwd.getpwuid(uid).pw_name
        except KeyError:  # a container's user needn't be listed
            name = str(uid)
        return cls(name, uid, frozenset((os.getegid(), *os.getgroups())))


@dataclass(frozen=True, slots=True)
class Access:
    """Whether a user may open a port, and whose group could.

    Attributes:
        group: that owns the port.
        listed: whether the user is in that group by the system's list; with `allowed` false, a new login is due.
    """

    allowed: bool
    group: str
    listed: bool


def list_ports(dev: Path = DEV) -> list[str]:
    """Paths of the serial ports that servos may be on: the lasting names by-id first, then USB adapters by number."""
    lasting = sorted(map(str, (dev / "serial" / "by-id").glob("*")))
    numbered = [str(path) for kind in ("ttyUSB*", "ttyACM*") for path in sorted(dev.glob(kind), key=_by_number)]
    return lasting + numbered


def describe_ports(dev: Path = DEV) -> str:
    """The ports that there are, for a message."""
    ports = list_ports(dev)
    return f"ports here: {', '.join(ports)}" if ports else "no USB serial port is here: is the adapter plugged in?"


def find_holders(port: str, proc: Path = PROC) -> list[Holder]:
    """Programs other than this one that have the port open; those of other users are seen by root alone."""
    target = os.path.realpath(port)
    emulated = target.startswith("/dev/pts/")
    holders: list[Holder] = []
    for entry in sorted(proc.glob("[0-9]*"), key=lambda entry: int(entry.name)):
        pid = int(entry.name)
        if pid == os.getpid() or target not in (files := _open_files(entry)):
            continue
        if not (emulated and files & _MASTERS):  # an emulator holds both ends of its pseudo-terminal
            holders.append(Holder(pid, _command(entry)))
    return holders


def describe_holders(holders: Sequence[Holder]) -> str:
    """Programs in a message: "pid 812 (python run.py)"."""
    return ", ".join(f"pid {holder.pid} ({holder.command})" for holder in holders)


def check_free(port: str, *, dev: Path = DEV, proc: Path = PROC) -> None:
    """Raise NoPort, which says what there is instead, for a port that isn't there or that another program has open."""
    if not Path(port).exists():
        raise NoPort(f"no port {port}; {describe_ports(dev)}")
    if holders := find_holders(port, proc):
        raise NoPort(f"{port} is held by {describe_holders(holders)}; close that first")


def find_access(port: str, user: User) -> Access:
    """Whether the permissions of the port let the user read and write it; raises OSError for a port that isn't there.

    Not handled: access control lists (a desktop's login may get one), so ask `os.access` for this program itself.
    """
    status = Path(port).stat()
    if user.uid == 0:
        allowed = True
    elif user.uid == status.st_uid:
        allowed = status.st_mode & 0o600 == 0o600
    elif status.st_gid in user.groups:
        allowed = status.st_mode & 0o060 == 0o060
    else:
        allowed = status.st_mode & 0o006 == 0o006
    try:
        group = grp.getgrgid(status.st_gid)
    except KeyError:
        return Access(allowed, str(status.st_gid), listed=False)
    return Access(allowed, group.gr_name, listed=user.name in group.gr_mem)


def latency_file(port: str, sys: Path = SYS) -> Path:
    """Where the kernel keeps an FTDI adapter's latency timer; there is no such file for others."""
    return sys / "bus" / "usb-serial" / "devices" / Path(os.path.realpath(port)).name / "latency_timer"


def read_latency_ms(port: str, sys: Path = SYS) -> int | None:
    """How long an FTDI adapter holds received bytes back, ms; None for a port without such a timer."""
    try:
        return int(latency_file(port, sys).read_text(encoding="ascii"))
    except (OSError, ValueError):
        return None


def _by_number(path: Path) -> tuple[int, str]:
    return len(path.name), path.name


def _open_files(entry: Path) -> set[str]:
    files: set[str] = set()
    try:
        for link in (entry / "fd").iterdir():
            with contextlib.suppress(FileNotFoundError):  # closed meanwhile
                files.add(str(link.readlink()))
    except OSError:  # it has ended, or is another user's
        pass
    return files


def _command(entry: Path) -> str:
    try:
        words = (entry / "cmdline").read_bytes().split(b"\0")
        name = (entry / "comm").read_text(encoding="utf-8", errors="replace").strip()
    except OSError:
        return "?"
    return b" ".join(words).decode("utf-8", errors="replace").strip() or name
