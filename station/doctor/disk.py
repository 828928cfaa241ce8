"""Check of the disk: what a minute of capture takes, against what is free."""

from __future__ import annotations

from pathlib import Path

from station.doctor.finding import Finding, Verdict
from station.recording.sizes import ExpectedRates

WHERE = "disk"
MB = 1e6
# A session should leave room for some more; under a minute there is none for one.
COMFORTABLE_MIN, LEAST_MIN = 10.0, 1.0


def check_disk(folder: Path, free_bytes: int, rates: ExpectedRates) -> Finding:
    """Whether some minutes of capture fit on the disk of `folder`."""
    minute_bytes = 60 * rates.bytes_per_s
    minutes = free_bytes / minute_bytes
    found = f"{_size(free_bytes)} free, a minute takes about {_size(minute_bytes)}"
    if minutes < LEAST_MIN:
        verdict = Verdict.BLOCKS
    elif minutes < COMFORTABLE_MIN:
        verdict = Verdict.WARNING
    else:
        verdict = Verdict.OK
    mend = "" if verdict is Verdict.OK else f"make room on the disk of {folder}, or give --out on another disk"
    values = {"folder": str(folder), "free_bytes": free_bytes, "minute_bytes": round(minute_bytes)}
    return Finding(WHERE, "space", verdict, found, mend, values, brief=found)


def _size(count: float) -> str:
    return f"{count / 1e9:.1f} GB" if count >= 1e9 else f"{count / MB:.0f} MB"
