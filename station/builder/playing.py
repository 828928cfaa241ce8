"""Algorithm 2 of the paper frame by frame, for a page that shows it as it goes; each frame is a value."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from station.builder.draft import Draft
from station.drawn import look_at
from station.errors import InvalidData
from station.kinematics import se3
from station.logs import FloatArray
from station.simulate import (
    NOISE_MODELS,
    Noise,
    SimulationOptions,
    place_objects,
    start_states,
    walk_root,
    walk_states,
)
from station.simulate.placing import layout

# A camera 1 m in front of where the root began, its x to the right and its y down.
T_CAMERA_START = se3.inverse(look_at(np.array([0.0, -1.0, 0.4]), np.array([0.0, 0.0, 0.2])))


@dataclass(frozen=True, slots=True)
class TrialSettings:
    """How a draft is moved, watched and fitted.

    Attributes:
        frames: that are fitted.
        noise_translation_m, noise_rotation_rad: magnitudes of the noise.
        inflation: virtual trackers near each part.
        method: of the fit, "station" or "paper".
        seed: of all that is random.
        motion: "walk", Algorithm 2's, or "smooth"; played is always the walk.
        noise: key of `station.simulate.NOISE_MODELS`.
        root: "moving" or "static".

    Raises:
        InvalidData: where any of it can't be, with what can; the fit itself checks its method.
    """

    frames: int = 100
    noise_translation_m: float = 0.002
    noise_rotation_rad: float = 0.01
    inflation: int = 0
    method: str = "station"
    seed: int = 0
    motion: str = "walk"
    noise: str = "uniform"
    root: str = "moving"

    def __post_init__(self) -> None:
        self.options()
        if isinstance(self.seed, bool) or not isinstance(self.seed, int) or self.seed < 0:
            raise InvalidData(f"seed is {self.seed!r}; want a whole number, 0 or more")

    def noise_model(self) -> Noise:
        """The noise with its magnitudes; raises InvalidData for a model that isn't there."""
        if self.noise not in NOISE_MODELS:
            raise InvalidData(f"noise '{self.noise}' is unknown; choose one of {', '.join(NOISE_MODELS)}")
        return NOISE_MODELS[self.noise](self.noise_translation_m, self.noise_rotation_rad)

    def options(self) -> SimulationOptions:
        """What the simulator is asked for."""
        return SimulationOptions(
            frames=self.frames,
            inflation=self.inflation,
            noise=self.noise_model(),
            motion=self.motion,
            root=self.root,
        )


@dataclass(frozen=True, eq=False, slots=True)
class Play:
    """One frame of a walk.

    The root starts where it is drawn, not up to 5 m away as in line 1 of the paper, so that it stays in view.

    Attributes:
        draft: that moves.
        settings: how; their frames don't end it.
        frame: number of this one.
        q: (C,) states, as the columns of the draft's tree say.
        T_start_root: (4, 4) the root where it is now in the root where it began.
    """

    draft: Draft
    settings: TrialSettings
    frame: int
    q: FloatArray
    T_start_root: FloatArray = field(default_factory=lambda: np.eye(4))

    @property
    def states(self) -> dict[str, float]:
        """The states by column [rad or m], as sliders show them."""
        return dict(zip(self.draft.tree.columns, self.q.tolist(), strict=True))

    @property
    def truth(self) -> dict[str, FloatArray]:
        """(4, 4) pose of each part in the root where it began."""
        return place_objects(self.draft.tree, self.T_start_root, self.q)

    @property
    def trackers(self) -> dict[str, FloatArray]:
        """(4, 4) pose of each tracker there: the parts, and the virtual trackers near each, at one place in a play."""
        what = layout(self.draft.tree, self.settings.inflation)
        u = np.random.default_rng([self.settings.seed, 0, 2]).uniform(-1.0, 1.0, (1, len(what.loose), 6))
        T_body_part = what.mounted(u, self.settings.options().nearby_m, planar=False)[0]
        truth = self.truth
        bodies = np.stack([truth[body] for body in what.tree.bodies])
        return dict(zip(what.tree.parts, bodies[what.body] @ T_body_part, strict=True))

    @property
    def measured(self) -> dict[str, FloatArray]:
        """The same as a tracker would report it, each with noise of its own.

        Noise of a camera is that of one at T_CAMERA_START.
        """
        trackers, noise = self.trackers, self.settings.noise_model()
        T_ref_start = T_CAMERA_START if noise.reference == "camera" else np.eye(4)
        seen = noise.perturbed(T_ref_start @ np.stack(list(trackers.values())), self._rng(1))
        return dict(zip(trackers, se3.inverse(T_ref_start) @ seen, strict=True))

    def stepped(self) -> Play:
        """The next frame: lines 6 to 9 of Algorithm 2."""
        after = replace(self, frame=self.frame + 1)
        rng, options = after._rng(0), self.settings.options()
        q = walk_states(self.draft.tree, self.q, rng)
        T = self.T_start_root
        if self.settings.root == "moving":
            T = walk_root(T, rng, options.root_step_m, options.root_step_rad)
        return replace(after, q=q, T_start_root=T)

    def with_settings(self, settings: TrialSettings) -> Play:
        """The same frame, gone on with under other settings: what noise is on it, and whether its root moves."""
        return replace(self, settings=settings)

    def _rng(self, what: int) -> np.random.Generator:
        """Random numbers of this frame, of its motion (0) or its noise (1)."""
        return np.random.default_rng([self.settings.seed, self.frame, what])


def start_play(draft: Draft, settings: TrialSettings) -> Play:
    """The first frame of a walk: states anywhere within the limits (line 1 of Algorithm 2)."""
    start = Play(draft, settings, 0, np.zeros(len(draft.tree.columns)))
    return replace(start, q=start_states(draft.tree, start._rng(0)))
