"""The page's table of what a trial found."""

import re
from dataclasses import replace

from station.builder.page.found import HEADER, found_html
from station.builder.stored import load_draft
from station.builder.trial import TrialSettings, run_trial


def texts(html: str) -> str:
    return " ".join(re.sub(r"<[^>]*>", " ", html).split())


def test_the_table_says_of_each_joint_what_was_found_and_which_type_is_wrong():
    trial = run_trial(load_draft("experiment1"), TrialSettings(frames=60))
    html = found_html(trial, is_older=False)
    told = texts(html)
    assert " ".join(HEADER) in told and trial.headline in told and "before it was changed" not in told
    for row in trial.rows:
        axis = row.axis.replace(" (", " ").replace(")", "")
        assert f"{row.true} {row.found_type} {axis}" in told
    assert "drawn" not in told.replace("red as drawn", "")

    scores = trial.scores
    wrong = replace(scores.joints[0], found_type="revolute" if scores.joints[0].true_type != "revolute" else "rigid")
    misfit = replace(trial, scores=replace(scores, joints=(wrong, *scores.joints[1:])))
    told = texts(found_html(misfit, is_older=True))
    assert f"{wrong.joint} {wrong.found_type} drawn {wrong.true_type}" in told and "before it was changed" in told
