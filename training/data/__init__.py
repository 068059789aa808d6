"""Shapes, pairs and the data modules that feed the training."""
