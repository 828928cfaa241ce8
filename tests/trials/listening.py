"""Where a program listens, by the kernel's own tables."""

from __future__ import annotations

from ipaddress import ip_address
from pathlib import Path

LISTEN, UNCONNECTED = "0A", "07"  # states of sockets in /proc/net/tcp and /proc/net/udp (proc(5))
TABLES = {"tcp": LISTEN, "tcp6": LISTEN, "udp": UNCONNECTED, "udp6": UNCONNECTED}


def listening(pid: int) -> dict[str, list[str]]:
    """By table, the addresses and ports on which a program takes connections or datagrams."""
    own = _sockets(pid)
    found: dict[str, list[str]] = {}
    for table, state in TABLES.items():
        rows = [row.split() for row in Path(f"/proc/{pid}/net/{table}").read_text().splitlines()[1:]]
        found[table] = [_address(row[1]) for row in rows if row[3] == state and row[9] in own]
    return found


def _sockets(pid: int) -> set[str]:
    """Inodes of the sockets that a program holds."""
    links = []
    for path in Path(f"/proc/{pid}/fd").iterdir():
        try:
            links.append(str(path.readlink()))
        except FileNotFoundError:
            continue  # closed meanwhile
    return {link[len("socket:[") : -1] for link in links if link.startswith("socket:[")}


def _address(text: str) -> str:
    """An address as people write it, of one in words of hexadecimal digits, each in the machine's byte order."""
    digits, _, port = text.partition(":")
    words = [bytes.fromhex(digits[k : k + 8])[::-1] for k in range(0, len(digits), 8)]
    return f"{ip_address(b''.join(words))}:{int(port, 16)}"
