"""Odometry: trajectories of many methods on the same clouds, and pairs of distant frames."""
