"""``python -m training fit -c config.yaml``."""

from training.cli import main

raise SystemExit(main())
