"""`python -m bayes_damper` does what `bayes-damper` does."""

import sys

from bayes_damper.cli import main

if __name__ == "__main__":
    sys.exit(main())
