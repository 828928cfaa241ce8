"""What a report is made of: a session's numbers as plain values, whoever read them and from where."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from station.compare import Comparison
from station.fit.image_checks import Residuals
from station.fit.result import Fit
from station.logs import FloatArray
from station.report.figure7 import Viewing
from station.report.visibility import Visibility


class Happening(Protocol):
    """Something that happened, `t_s` after the session's start; level is INFO, WARN or ERROR."""

    @property
    def t_s(self) -> float: ...

    @property
    def level(self) -> str: ...

    @property
    def text(self) -> str: ...


@dataclass(frozen=True, eq=False)
class Timing:
    """When frames came and servos were read, seconds since the session's start.

    Attributes:
        frame_s: (F,) stamps of the frames.
        frame_index: (F,) the camera's numbers of them; dropped ones leave gaps.
        request_s, reply_s: (N,) of each reading.
        latency_s: taken off each frame's stamp, as the rig says.
        fps: what the camera was asked for; None if unknown.
    """

    frame_s: FloatArray
    frame_index: NDArray[np.int64]
    request_s: FloatArray
    reply_s: FloatArray
    latency_s: float = 0.0
    fps: float | None = None

    @property
    def reading_s(self) -> FloatArray:
        """(N,) the stamp of each reading, midway between request and reply."""
        return (self.request_s + self.reply_s) / 2

    @property
    def lost(self) -> NDArray[np.int64]:
        """(F,) how many frames the camera counted between this one and the one before, and nobody recorded."""
        return np.maximum(np.diff(self.frame_index, prepend=self.frame_index[:1] - 1) - 1, 0)


@dataclass(frozen=True, eq=False)
class Servos:
    """What S servos said of themselves at T times, NaN where one said nothing.

    Attributes:
        t_s: (T,).
        names: of the servos.
        temperature_c, voltage_v, load: (T, S); load as a share of the most that the model has.
    """

    t_s: FloatArray
    names: tuple[str, ...]
    temperature_c: FloatArray
    voltage_v: FloatArray
    load: FloatArray


@dataclass(frozen=True)
class Redoing:
    """What it takes to do a session again.

    Attributes:
        lines: of the command line, in their order.
        files: texts of rig.toml, motion.toml, camera.toml, markers.toml, by name.
        versions: of the programs.
        method: of the fit, as kinematics.json tells it.
    """

    lines: Sequence[str] = ()
    files: Mapping[str, str] = field(default_factory=dict[str, str])
    versions: Mapping[str, str] = field(default_factory=dict[str, str])
    method: Mapping[str, object] = field(default_factory=dict[str, object])


@dataclass(frozen=True, eq=False)
class Material:
    """All that a report tells; None and empty where there is nothing to tell.

    Attributes:
        title: the session's name.
        facts: name, state, start, rig, what the session is of.
        fit: the tree and the states of its joints; None where nothing was fitted.
        comparison: with commands and read-back.
        viewing: by commanded joint.
        readback_steps: what a count of each joint's read-back is worth [rad or m], by joint.
        warnings: sentences.
        visibility: when the parts were seen.
        T_root_camera: (4, 4) where the camera stood, in the root's frame.
        counts: of session.json: frames, drops by reason, bus errors.
        events: in the order of their times.
        redoing: what it takes to do the session again.
        residuals: of corners, tested; None where the tree was not refined on them.
    """

    title: str
    facts: Mapping[str, str] = field(default_factory=dict[str, str])
    fit: Fit | None = None
    comparison: Comparison | None = None
    viewing: Viewing | None = None
    readback_steps: Mapping[str, float] = field(default_factory=dict[str, float])
    warnings: Sequence[str] = ()
    visibility: Visibility | None = None
    T_root_camera: FloatArray | None = None
    timing: Timing | None = None
    servos: Servos | None = None
    counts: Mapping[str, int] = field(default_factory=dict[str, int])
    events: Sequence[Happening] = ()
    redoing: Redoing = Redoing()
    residuals: Residuals | None = None
