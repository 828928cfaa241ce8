"""The whole tree from the corners: joints, mounts, states and the camera's numbers from what its pixels show.

A marker's pose alone throws away what is known besides: that a joint leaves one number free, that a base stands still,
that all pictures are one camera's. Here corners themselves are the measurements: every number of the tree at once, by
least squares on their distances in the distorted picture, in units of their covariances (refinement).
"""
