"""What a detector errs by itself: the same whenever a marker is seen in the same way, so that it does not average out.

The deviations of corners know nothing of it. Measured on rendered pictures; a real camera's may be larger.
"""

from __future__ import annotations

# Of a coordinate, px: as large as its noise. Of 44 clean sessions 22 were suspected of something without it, none with
# it; 0.01 was the least that did for the 10 of them that it was set by.
DETECTOR_PX = 0.015
# Root mean square by which a body's corners may seem to move with it, px: up to 0.027 of one marker was seen.
REPEATED_PX = 0.05
