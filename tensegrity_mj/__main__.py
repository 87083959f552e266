"""`python -m tensegrity_mj` is `tensegrity-mj`."""

import sys

from tensegrity_mj.cli import main

if __name__ == "__main__":
    sys.exit(main())
