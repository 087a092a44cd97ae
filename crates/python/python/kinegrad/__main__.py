"""The command line: `kinegrad`, or `python -m kinegrad`."""

from __future__ import annotations

import signal
import sys

from kinegrad import _kinegrad


def main() -> int:
    """Runs the command line of `sys.argv` and returns its exit code."""
    # Python code does not run meanwhile, so its handler of Ctrl-C would never be called.
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    return _kinegrad.main(["kinegrad", *sys.argv[1:]])


if __name__ == "__main__":
    sys.exit(main())
