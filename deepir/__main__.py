"""`python -m deepir`: the command line where `deepir` itself is not on the path."""

import sys

from deepir.cli import main

sys.exit(main())
