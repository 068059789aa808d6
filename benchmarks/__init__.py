"""Honest tables: every method on the same arrays, in the same run, seeded and listed."""
