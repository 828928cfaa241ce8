"""Time from a frame to poses with covariances, beside OpenCV's detectMarkers with its default parameters; one thread.

A stream of frames of a moving scene (640x480, 8 markers of 50 mm, 0.5 to 0.75 m away, tilts to 50 deg, mild blur and
noise; grey, as the colour conversion is nobody's merit) is taken twice: each frame by detectMarkers and by our stages,
one after the other, so that both see the same machine. Processor time, as what else the machine does is not the point;
medians over the frames; the last column is the ratio to detectMarkers. The rate is that of our stages over the whole
stream, by processor time; at last the stream comes at 60 frames/s of the real clock.

Run: python -m tests.benchmarks.perception_speed [--frames N] [--repeats N]
"""

from __future__ import annotations

import argparse
import time
from collections import defaultdict

import cv2
import numpy as np

from calibration.intrinsics import FloatArray
from drivers.camera import QUEUE_FRAMES
from station.perception.corners import Detections, MarkerDetector
from station.perception.joint_covariance import joint_covariance
from station.perception.marker_tracker import MarkerTracker
from station.perception.pose import estimate_poses
from tests import rendered_markers

SIZE_M = 0.05
MARKERS = 8
CAMERA = rendered_markers.webcam()
FRAME_RATE_HZ = 30.0
PACE_HZ, PACED_S = 60.0, 10.0
Stages = dict[str, list[float]]


def poses_at(t_s: float) -> FloatArray:
    """(8, 4, 4) T_cam_marker: two rows of four that sway, turn and come nearer."""
    out = []
    for m in range(MARKERS):
        phase = 0.8 * m
        x = -0.225 + 0.15 * (m % 4) + 0.012 * np.sin(1.9 * t_s + phase)
        y = (-0.08 if m < 4 else 0.08) + 0.012 * np.cos(1.3 * t_s + phase)
        z = 0.62 + 0.08 * np.sin(0.7 * t_s + phase)
        tilt = np.radians(25 + 25 * np.sin(0.9 * t_s + 2 * phase))
        out.append(rendered_markers.facing(tilt, 0.6 * t_s + phase, 0.5 * t_s + phase, (x, y, z)))
    return np.stack(out)


def stream(frames: int) -> list[np.ndarray]:
    rng = np.random.default_rng(0)
    images = []
    for n in range(frames):
        light = rendered_markers.scene_light(range(MARKERS), poses_at(n / FRAME_RATE_HZ), SIZE_M, CAMERA, rays=3)
        images.append(rendered_markers.developed(light, rng))
    return images


class Watch:
    """Processor times of named stages, in s."""

    def __init__(self) -> None:
        self.times: Stages = defaultdict(list)
        self._last = time.process_time()

    def start(self) -> None:
        self._last = time.process_time()

    def stop(self, stage: str) -> None:
        now = time.process_time()
        self.times[stage].append(now - self._last)
        self._last = now


def with_poses(found: Detections, watch: Watch) -> None:
    joint_px2 = joint_covariance(found.corners_px, found.covariance_px2)
    estimate_poses(found.corners_px, np.full(len(found), SIZE_M), CAMERA, joint_px2)
    watch.stop("poses")  # and their covariances


def one_by_one(detector: MarkerDetector, image: np.ndarray, watch: Watch) -> int:
    """Each frame as if it were alone: the quick search, refinement, poses with covariances."""
    watch.start()
    rough = detector.search(image)
    watch.stop("search")
    found = detector.refine(image, rough)
    watch.stop("refinement")
    with_poses(found, watch)
    return len(found)


def as_stream(tracker: MarkerTracker, image: np.ndarray, watch: Watch) -> int:
    """The frames as a stream: markers followed, searched for where that is due; refinement included."""
    watch.start()
    found = tracker.detect(image)
    watch.stop("detection")
    with_poses(found, watch)
    return len(found)


def whole(times: Stages) -> FloatArray:
    """(N,) s of all stages, frame by frame."""
    return np.sum(list(times.values()), axis=0)


def show(title: str, times: Stages, plain_s: float) -> None:
    total = whole(times)
    print(title)
    for stage, each in [*times.items(), ("the whole", total)]:
        print(f"  {stage:<14}{1e3 * np.median(each):8.2f} ms{np.median(each) / plain_s:8.2f}")
    print(f"  {len(total) / total.sum():.0f} frames/s sustained; the slowest frame took {1e3 * total.max():.1f} ms")


def run(frames: int, repeats: int) -> None:
    cv2.setNumThreads(1)
    images = stream(frames)
    plain = cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50))
    opencv, single, streamed = Watch(), Watch(), Watch()
    counts = np.zeros(3)
    for _ in range(repeats):
        detector = MarkerDetector(rendered_markers.DICTIONARY, CAMERA)
        tracker = MarkerTracker(rendered_markers.DICTIONARY, CAMERA, range(MARKERS))
        for image in images:
            opencv.start()
            ids = plain.detectMarkers(image)[1]
            opencv.stop("detectMarkers")
            counts[0] += 0 if ids is None else len(ids)
            counts[1] += one_by_one(detector, image, single)
            counts[2] += as_stream(tracker, image, streamed)
    plain_s = float(np.median(opencv.times["detectMarkers"]))
    show("OpenCV, default parameters", opencv.times, plain_s)
    show("ours, each frame alone", single.times, plain_s)
    show("ours, as a stream", streamed.times, plain_s)
    opencv_seen, single_seen, stream_seen = counts / (MARKERS * repeats * frames)
    print(f"markers seen: OpenCV {opencv_seen:.1%}, each frame alone {single_seen:.1%}, as a stream {stream_seen:.1%}")


def paced(images: list[np.ndarray], seconds: float) -> None:
    """Take frames as they arrive, PACE_HZ a second of the real clock, and say how long after that each was done."""
    cv2.setNumThreads(1)
    tracker, watch = MarkerTracker(rendered_markers.DICTIONARY, CAMERA, range(MARKERS)), Watch()
    done_s = []
    start_s = time.monotonic()
    for n in range(round(seconds * PACE_HZ)):
        arrives_s = start_s + n / PACE_HZ
        time.sleep(max(arrives_s - time.monotonic(), 0.0))
        with_poses(tracker.detect(images[n % len(images)]), watch)
        done_s.append(time.monotonic() - arrives_s)
    late = np.array(done_s) * PACE_HZ
    print(f"{PACE_HZ:g} frames/s of the real clock, {len(late)} frames")
    print(f"  done {1e3 * np.median(done_s):.1f} ms after arrival (median), {1e3 * max(done_s):.1f} ms at most")
    print(f"  {np.count_nonzero(late > 1)} made the next one wait", end=", ")
    print(f"{np.count_nonzero(late > QUEUE_FRAMES)} so long that a camera would have dropped one")


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--frames", type=int, default=90)
    options.add_argument("--repeats", type=int, default=4)
    chosen = options.parse_args()
    run(chosen.frames, chosen.repeats)
    paced(stream(chosen.frames), PACED_S)


if __name__ == "__main__":
    main()
