"""Random arms for tests of motions."""

from __future__ import annotations

from hypothesis import strategies as st

from station.motion import JointLimits, Unit

FULL_TURN = {"rad": 3.1, "m": 0.4}


@st.composite
def joint_limits(draw: st.DrawFn, name: str, *, accelerations: bool = True) -> JointLimits:
    """A joint, revolute or prismatic, parked anywhere within its limits, maybe with a greatest acceleration."""
    unit: Unit = draw(st.sampled_from(("rad", "rad", "m")))
    most = FULL_TURN[unit]
    lower = draw(st.floats(-most, 0.9 * most))
    upper = draw(st.floats(lower + 0.05 * most, most))
    park = lower + draw(st.floats(0.0, 1.0)) * (upper - lower)
    speed = draw(st.floats(0.05, 3.0)) * (1.0 if unit == "rad" else 0.1)
    limited = accelerations and draw(st.booleans())
    return JointLimits(name, lower, upper, speed, park, unit, draw(st.floats(0.5, 20.0)) * speed if limited else None)


@st.composite
def arms(draw: st.DrawFn, *, accelerations: bool = True) -> tuple[JointLimits, ...]:
    """One to seven joints."""
    count = draw(st.integers(1, 7))
    return tuple(draw(joint_limits(f"joint_{k}", accelerations=accelerations)) for k in range(count))
