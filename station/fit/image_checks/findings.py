"""What the tests on a fit's residuals found, and how it is said."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

# One clean session in a hundred may be suspected of something: all tests of a session together.
LEVEL = 0.01
# A unit's factor from SI, and its name.
UNITS = {"mm": 1e3, "deg": float(np.degrees(1.0)), "px": 1.0, "%": 1e2}


@dataclass(frozen=True)
class Size:
    """How large an effect is.

    Attributes:
        value: in the unit, not negative but where a sign has a meaning.
        unit: "mm", "deg", "px", "%".
        std: its standard deviation.
    """

    value: float
    unit: str
    std: float

    def __str__(self) -> str:
        digits = int(np.clip(1 - np.floor(np.log10(self.std)), 0, 4)) if self.std > 0 else 2
        gap = "" if self.unit == "%" else " "
        return f"{self.value:.{digits}f} ± {self.std:.{digits}f}{gap}{self.unit}"


@dataclass(frozen=True)
class Finding:
    """One thing that the fit's model doesn't know of.

    Attributes:
        kind: "marker", "part", "camera", "camera_drift", "focal", "focal_drift", "edges", "place" or "tilt".
        text: a sentence, with sizes and times.
        sizes: of the effect.
        p_value: chance of as much in a clean session, all its tests together.
        marker_id: of the marker; None where it is about no single one.
        part: that the marker is on, or that moved; None likewise.
        t_s: when it came; None for what holds all the time.
        t_std_s: standard deviation of that.
        or_else: what would explain the corners as well.
    """

    kind: str
    text: str
    sizes: tuple[Size, ...]
    p_value: float
    marker_id: int | None = None
    part: str | None = None
    t_s: float | None = None
    t_std_s: float | None = None
    or_else: tuple[str, ...] = ()


@dataclass(frozen=True)
class ModelChecks:
    """All that was tested in one session.

    Attributes:
        findings: the surest first.
        tests: how many questions were asked.
        level: chance that a clean session has a finding.
        untested: what couldn't be asked, and why.
    """

    findings: tuple[Finding, ...] = ()
    tests: int = 0
    level: float = LEVEL
    untested: tuple[str, ...] = ()

    @property
    def summary(self) -> str:
        """One sentence."""
        tested = f"{self.tests} tests, at a level of {100 * self.level:g} in 100 for all together"
        count = len(self.findings)
        what = "nothing found" if not count else "1 finding" if count == 1 else f"{count} findings"
        return f"{what} ({tested})"
