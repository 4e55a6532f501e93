"""Owns the door of the program: `fte-sniff`, and `python -m fte_sniff`. It knows only what to load.

Until all is loaded Ctrl-C ends the program as it ends any other, without a traceback.
"""

import signal


def main() -> None:
    """Load the command line, and run it."""
    interruptible = signal.getsignal(signal.SIGINT) is signal.default_int_handler
    if interruptible:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    from fte_sniff.cli import main as run

    if interruptible:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    run()


if __name__ == "__main__":
    main()
