"""The command ``mbfmu``, and ``python -m mbfmu``."""

from __future__ import annotations

import sys


def main() -> int:
    """Run the command. Loading its modules takes a second, in which Ctrl-C is to be told like at any other time."""
    try:
        from mbfmu.cli import main as command
    except KeyboardInterrupt:
        print("mbfmu: interrupted; nothing was begun", file=sys.stderr)  # noqa: T201
        return 130
    return command()


if __name__ == "__main__":
    sys.exit(main())
