"""`python -m dieseltwin` is the command line."""

import sys

from dieseltwin.cli.app import main

sys.exit(main())
