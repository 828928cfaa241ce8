"""The learner: from a PoseLog to a kinematic tree and its joint states."""
