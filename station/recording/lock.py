"""Who records into a session's folder, or repairs it: one program at a time, by a lock that a kill releases too."""

from __future__ import annotations

import errno
import os
from pathlib import Path
from types import TracebackType

from station.errors import StationError

try:
    import fcntl
except ImportError:  # pragma: no cover (Windows has no flock; there two programs could record into one folder)
    fcntl = None

# Any other error means a file system without locks, as some of the network have none.
TAKEN = (errno.EWOULDBLOCK, errno.EACCES)


class SessionBusy(StationError):
    """Another program records into the folder, or repairs it."""


class SessionLock:
    """The right to write into a session's folder, from now until `release` or the end of the program.

    The lock is on the folder itself (flock), so that it leaves no file behind and is gone with whoever held it.

    Attributes:
        exclusive: whether others are kept out; not on a file system without locks. (Without flock, as on Windows, a
            file that is being recorded can't be replaced either.)

    Raises:
        SessionBusy: somebody else has it.
        StationError: the folder isn't there, or can't be read.
    """

    def __init__(self, folder: Path) -> None:
        self._fd = -1
        self.exclusive = True
        if fcntl is None:
            return
        try:
            fd = os.open(folder, os.O_RDONLY)
        except OSError as error:
            raise StationError(f"{folder} can't be opened: {error.strerror}") from error
        try:
            fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            os.close(fd)
            if error.errno not in TAKEN:
                self.exclusive = False
                return
            raise SessionBusy(
                f"{folder} is being recorded or repaired, by another program or this one\nwait for its end, or stop it"
            ) from error
        self._fd = fd

    def release(self) -> None:
        """Let others write; more than once does no harm."""
        if self._fd >= 0 and fcntl is not None:
            fcntl.flock(self._fd, fcntl.LOCK_UN)  # also for children that a fork gave the descriptor to
            os.close(self._fd)
            self._fd = -1

    def __enter__(self) -> SessionLock:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.release()
