"""``python -m debris_scanner`` is ``debris-scan``."""

import sys

from debris_scanner.cli.main import main

sys.exit(main())
