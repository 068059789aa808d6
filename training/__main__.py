"""``python -m training fit -c config.yaml``."""

import sys

from model.exceptions import EquivAlignError
from training.cli import main

if __name__ == "__main__":
    try:
        sys.exit(main())
    except EquivAlignError as error:
        sys.stderr.write(f"training: {' '.join(str(error).split())}\n")
        sys.exit(2)
