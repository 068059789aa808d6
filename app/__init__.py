"""The ways in: the command line and the HTTP service."""

import os

# Before anything loads OpenMP: threads that wait by spinning make a call ten times slower as soon
# as something else wants a core.
os.environ.setdefault("OMP_WAIT_POLICY", "passive")
