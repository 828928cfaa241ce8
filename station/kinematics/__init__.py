"""Pure kinematics: rigid motions, metric, joint types, trees."""
