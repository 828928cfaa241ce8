"""The servos that a rig names against those that a scan found."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from drivers.probe import Setting
from drivers.scan import Found
from drivers.servo_models import ServoModel, load_model
from station.formats.rig import RigTable


@dataclass(frozen=True)
class Expected:
    """A servo that a rig names."""

    servo_id: int
    joint: str
    model: ServoModel
    setting: Setting

    @property
    def where(self) -> str:
        """The servo in a message."""
        return f"servo {self.servo_id} ({self.joint})"


@dataclass(frozen=True)
class Match:
    """What a scan found beside what was expected; either may be missing.

    Attributes:
        verdict: "as expected", "missing", "wrong model", "wrong baud", "wrong protocol", "unexpected".
        found: at this id.
    """

    verdict: str
    expected: Expected | None
    found: Found | None


def expected_servos(table: RigTable) -> tuple[Expected, ...]:
    """The servos that a rig names, in its order; raises DriverError for an unknown model."""
    setting = rig_setting(table)
    return tuple(
        Expected(servo.id, joint.name, load_model(servo.model, protocol=table.bus.protocol), setting)
        for joint in table.joint
        for servo in joint.servo
    )


def rig_setting(table: RigTable) -> Setting:
    """How a rig speaks to its servos."""
    return Setting(table.bus.protocol, table.bus.baud)


def match_found(expected: Sequence[Expected], found: Iterable[Found]) -> list[Match]:
    """Each expected servo with what was found at its id, then what wasn't expected."""
    left = list(found)
    matches: list[Match] = []
    for want in expected:
        at_id = [have for have in left if have.servo_id == want.servo_id]
        at_id.sort(key=lambda have: have.setting != want.setting)  # the rig's own setting first
        if not at_id:
            matches.append(Match("missing", want, None))
            continue
        left.remove(at_id[0])
        matches.append(Match(_verdict(want, at_id[0]), want, at_id[0]))
    return matches + [Match("unexpected", None, have) for have in left]


def _verdict(want: Expected, have: Found) -> str:
    if have.model_number not in (want.model.model_number, None):
        return "wrong model"
    if have.setting.protocol != want.setting.protocol:
        return "wrong protocol"
    return "as expected" if have.setting.baud == want.setting.baud else "wrong baud"
