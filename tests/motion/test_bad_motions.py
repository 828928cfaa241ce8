"""What is wrong in a motion.toml is told with the file, the step and the key, for each kind of step."""

from __future__ import annotations

import pytest

from station.errors import InvalidFile
from station.formats.motion import parse_motion
from station.motion import JointLimits

JOINTS = (JointLimits("pan", -1.5, 1.5, 1.0), JointLimits("lift", 0.0, 0.3, 0.1, park=0.1, unit="m"))
# Before each bad step there is a good one: numbers of steps count from 1.
HEAD = 'schema = "motion/1"\nname = "m"\nmode = "stream"\n[[step]]\neach_joint = {}\n[[step]]\n'
WAVE = "sinusoids = { duration_s = 9, joint = { pan = { amplitude_deg = 9, period_s = 3 } } }"

# What a step has, and what is said of it; keys are told as step 2, KEY.
BAD = {
    "two kinds": ("combined = {}\nexplore = {}", ("have combined and explore; want one of move, each_joint",)),
    "no kind": ("hold_s = 1", ("have none; want one of",)),
    "an unknown kind": ("wiggle = {}", ("wiggle: unknown key; known here: ",)),
    "each_joint: share": ("each_joint = { share = 1.5 }", ("each_joint, share", "1")),
    "each_joint: unknown key": ("each_joint = { poses = 3 }", ("each_joint, poses: unknown key; known here: share",)),
    "each_joint: joint": ('each_joint = { joints = ["knee"] }', ("no joint 'knee'; the rig has pan, lift",)),
    "each_joint: at_most_deg": ("each_joint = { at_most_deg = -3 }", ("each_joint, at_most_deg",)),
    "combined: poses": ("combined = { poses = 0 }", ("combined, poses",)),
    "combined: joint": ('combined = { joints = ["knee"] }', ("no joint 'knee'",)),
    "explore: poses": ("explore = { poses = 1.5 }", ("explore, poses",)),
    "explore: seed": ("explore = { seed = -1 }", ("explore, seed",)),
    "sinusoids: cycles": ("sinusoids = { cycles = 0 }", ("sinusoids, cycles",)),
    "sinusoids: ramp without joints": ("sinusoids = { ramp_s = 3 }", ("duration_s and ramp_s go with joint tables",)),
    "sinusoids: no duration": (
        "sinusoids = { joint = { pan = { amplitude_deg = 9, period_s = 3 } } }",
        ("want duration_s beside joint tables",),
    ),
    "sinusoids: share with joints": (WAVE.replace("{ duration", "{ share = 0.5, duration"), ("share goes without",)),
    "sinusoids: speed with joints": (WAVE + "\nspeed_deg_s = 9", ("leave speed_deg_s, speed_mm_s out",)),
    "sinusoids: period and frequency": (
        WAVE.replace("period_s = 3", "period_s = 3, frequency_hz = 1"),
        ("sinusoids, joint, pan", "want period_s or frequency_hz"),
    ),
    "sinusoids: no amplitude": (WAVE.replace("amplitude_deg = 9, ", ""), ("joint, pan", "want amplitude_deg")),
    "sinusoids: unit": (WAVE.replace("pan =", "lift ="), ("sinusoids, joint, lift: want amplitude_mm and centre_mm",)),
    "sinusoids: joint": (WAVE.replace("pan =", "knee ="), ("no joint 'knee'",)),
    "replay: nothing": ("replay = {}", ("replay", "want file, or t_s with deg.JOINT")),
    "replay: both": ('replay = { file = "a", t_s = [0, 1], deg.pan = [0, 1] }', ("want file, or t_s",)),
    "replay: counts": ("replay = { t_s = [0, 1], deg.pan = [0] }", ("pan has 1 states; want one for each of 2 t_s",)),
    "replay: unit": ("replay = { t_s = [0, 1], deg.lift = [0, 1] }", ("replay: lift belongs under mm",)),
    "replay: joint": ("replay = { t_s = [0, 1], deg.knee = [0, 1] }", ("no joint 'knee'",)),
    "replay: times": ("replay = { t_s = [1, 0], deg.pan = [0, 1] }", ("times must increase",)),
    "replay: speed": ("speed_deg_s = 9\nreplay = { t_s = [0, 1], deg.pan = [0, 1] }", ("leave speed_deg_s",)),
    "replay: file": ('replay = { file = "by_hand" }', ("replay names the recording by_hand, which isn't read here",)),
}


@pytest.mark.parametrize("name", BAD)
def test_a_bad_step_is_refused_with_file_step_and_key(name: str) -> None:
    step, said = BAD[name]
    with pytest.raises(InvalidFile) as error:
        parse_motion(HEAD + step + "\n", "bad.toml", JOINTS)
    text = str(error.value)
    assert text.startswith("bad.toml") and "step 2" in text
    for each in said:
        assert each in text


def test_the_good_steps_beside_them_are_read():
    parse_motion(HEAD + WAVE + "\n", "good.toml", JOINTS)
    parse_motion(HEAD + "replay = { t_s = [0, 1], deg.pan = [0, 1] }\n", "good.toml", JOINTS)
