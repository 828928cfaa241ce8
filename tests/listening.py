"""Which addresses a process listens on, as the kernel knows it."""

from __future__ import annotations

from pathlib import Path


def listening(pid: int | str = "self") -> set[str]:
    """The addresses that a process listens on, IPv4 and IPv6, as the kernel writes them."""
    inodes: set[str] = set()
    for link in Path(f"/proc/{pid}/fd").iterdir():
        try:
            inodes.add(link.readlink().name)
        except OSError:
            continue  # closed meanwhile
    rows = [
        line.split()
        for table in ("tcp", "tcp6")
        for line in Path(f"/proc/{pid}/net/{table}").read_text(encoding="ascii").splitlines()[1:]
    ]
    return {row[1] for row in rows if row[3] == "0A" and f"socket:[{row[9]}]" in inodes}
