"""Fitting the verifier of an artifact on pairs that the data pipeline makes."""
