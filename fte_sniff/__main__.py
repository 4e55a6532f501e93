"""Console entry point: `fte-sniff` and `python -m fte_sniff`.

While the program is loading, Ctrl-C ends it at once and without a traceback; afterwards the
command line handles it.
"""

# The built-in module behind `signal`, which would take time to import before Ctrl-C is handled.
import _signal as signal  # type: ignore[import-not-found]


def main() -> None:
    """Load and run the command line."""
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    from fte_sniff.cli import main as run

    run()


if __name__ == "__main__":
    main()
