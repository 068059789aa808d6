"""Training: data, losses, curriculum and the command line."""
