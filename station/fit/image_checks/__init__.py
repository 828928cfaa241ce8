"""What of the model that a fit in image space rests on is wrong, by tests on the corners that it leaves unexplained.

A marker that came off and was put on again, a camera that was touched, a lens that isn't the calibrated one: each would
move the corners in a way of its own. Of each way it is asked how much better the corners are explained with it than
without (a score test), after all that the fit itself can do about it, a joint's zero or a marker's mount, has been
taken out (freedoms, sums). What comes at an unknown time is looked for at every time (changes).

Noise is not what a detector states: errors of neighbouring frames are alike while nothing moves (weighing), and what a
lens model leaves changes as slowly as the object does. So all statistics are in units of what is seen between blocks of
time, where that is more than was stated (changes).
"""

from station.fit.image_checks.checks import check_image
from station.fit.image_checks.findings import LEVEL, Finding, ModelChecks, Size
from station.fit.image_checks.residuals import Residuals, checked_residuals

__all__ = ["LEVEL", "Finding", "ModelChecks", "Residuals", "Size", "check_image", "checked_residuals"]
