"""``python -m mbfmu`` is the command ``mbfmu``."""

import sys

from mbfmu.cli import main

sys.exit(main())
