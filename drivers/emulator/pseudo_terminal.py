"""The device that clients of the emulated bus open: a pseudo-terminal behind a path that stays the same."""

from __future__ import annotations

import fcntl
import os
import struct
import sys
import termios
import tty
from pathlib import Path

from drivers.errors import DriverError

_TCGETS2 = 0x802C542A  # linux/asm-generic/ioctls.h: termios2, which holds the baud as a number
_TERMIOS2_BYTES, _OSPEED_AT = 44, 40
_READ_BYTES = 4096


class PseudoTerminal:
    """A new pseudo-terminal, and a symbolic link that leads clients to it; both are gone after `close`.

    Args:
        link: where the link is made. A dead link is replaced; anything else that is there raises DriverError.
    """

    def __init__(self, link: Path) -> None:
        self._link = link
        self.fd, self._slave = os.openpty()  # the far end stays open here: a client may come and go
        try:
            tty.setraw(self._slave)  # or the line discipline would echo and edit
            os.set_blocking(self.fd, False)
            self.device = os.ttyname(self._slave)
            _point(link, self.device)
        except BaseException:
            self._close_ends()
            raise

    def receive(self) -> bytes:
        """The bytes that the client has sent."""
        return os.read(self.fd, _READ_BYTES)

    def send(self, data: bytes) -> None:
        """Bytes for the client; lost, as on a wire, where nobody reads and the line's buffer is full."""
        try:
            os.write(self.fd, data)
        except BlockingIOError:
            return

    def client_baud(self) -> int | None:
        """The baud that the client has set, None where the system doesn't tell."""
        if not sys.platform.startswith("linux"):
            return None
        try:
            termios2 = fcntl.ioctl(self._slave, _TCGETS2, bytes(_TERMIOS2_BYTES))
        except (OSError, termios.error):
            return None
        return int(struct.unpack_from("I", termios2, _OSPEED_AT)[0])

    def close(self) -> None:
        """Take the device away: a client that has it open finds it gone."""
        if self._link.is_symlink() and str(self._link.readlink()) == self.device:
            self._link.unlink()
        self._close_ends()

    def _close_ends(self) -> None:
        os.close(self.fd)
        os.close(self._slave)


def _point(link: Path, device: str) -> None:
    """Make the link lead to the device, in one step; raises DriverError."""
    if link.is_symlink() and not link.exists():
        link.unlink()  # of an emulator that was killed
    try:
        link.symlink_to(device)
    except FileExistsError as error:
        raise DriverError(f"{link} exists; name another path for the emulated bus, or remove it") from error
    except OSError as error:
        raise DriverError(f"can't make the link {link} to the emulated bus: {error.strerror}") from error
