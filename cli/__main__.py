"""`python -m tilth.cli COMMAND`: what `tilth COMMAND` does."""

import sys

from tilth.cli import main

sys.exit(main())
