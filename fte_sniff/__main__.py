"""Owns the door of the program: `fte-sniff`, and `python -m fte_sniff`. It knows only what to load.

Until all is loaded Ctrl-C ends the program as it ends any other, without a traceback; from then on
`cli` says what it does.
"""

# The one that `signal` is made on, and built in: nothing is loaded until Ctrl-C is seen to.
import _signal as signal  # type: ignore[import-not-found]


def main() -> None:
    """Load the command line, and run it."""
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    from fte_sniff.cli import main as run

    run()


if __name__ == "__main__":
    main()
