"""Odometry on the command line: options, files, report."""
