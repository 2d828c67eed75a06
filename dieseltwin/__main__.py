"""`python -m dieseltwin` is the command line."""

import sys

from dieseltwin.cli import main

sys.exit(main())
