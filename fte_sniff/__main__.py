"""Entry points: `fte-sniff`, `python -m fte_sniff`, and the processes that the program starts.

While the program is loading, Ctrl-C ends it at once and without a traceback; afterwards the
command line handles it. `fte-sniff` imports no code of the working folder.

An error in the program ends with `EXIT_INTERNAL`, because Python's own exit code for it, 1, means
that `check` or `doctor` says no.
"""

# The built-in module behind `signal`, which would take time to import before Ctrl-C is handled.
import _signal as signal  # type: ignore[import-not-found]
import sys

EXIT_INTERNAL = 70
"""The exit code of an error in the program, and of too little memory; `EX_SOFTWARE` of sysexits.h.
"""

_SWITCH_EVERY_S = 0.0005
"""How long a thread keeps the interpreter while another one waits for it, such as the one that
reads a port, or encodes rows; Python's 5 ms would leave a core idle."""

_SHORTAGES = (
    # A library that cannot be loaded has no error number, only the text.
    (("Too many open files",), 4, "too many open files; try `ulimit -n 4096`"),
    (
        ("MemoryError", "Cannot allocate memory", "failed to map segment", "start new thread"),
        EXIT_INTERNAL,
        "out of memory; end other programs, raise `ulimit -v`, or read fewer files at once",
    ),
)
"""Texts of errors, exit code, and message, if the system has too little of something."""


def main() -> None:
    """Load and run the command line."""
    sys.setswitchinterval(_SWITCH_EVERY_S)
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    import gc

    gc.disable()  # until the command is loaded: loading makes no garbage
    try:
        from fte_sniff.cli import main as run

        run()
    except (SystemExit, KeyboardInterrupt):
        raise
    except BaseException as error:  # noqa: BLE001  # a panic of polars is not an Exception
        _exit_if_short(error)
        import traceback

        traceback.print_exc()
        what = " ".join(traceback.format_exception_only(error)[-1].split())
        sys.stderr.write(f"fte-sniff: internal error ({what}); please report it with these lines\n")
        sys.exit(EXIT_INTERNAL)


def worker() -> None:
    """Load and run a capture process, see `session.control`."""
    sys.setswitchinterval(_SWITCH_EVERY_S)
    try:
        from fte_sniff.session.capture_process import run

        run()
    except Exception as error:
        _exit_if_short(error)
        raise


def _exit_if_short(error: BaseException | None) -> None:
    """Exit if the system has too little of something, with a line on standard error."""
    while error is not None:
        text = f"{type(error).__mro__} {error}"
        for texts, code, message in _SHORTAGES:
            if any(one in text for one in texts):
                sys.stderr.write(f"fte-sniff: {message}\n")
                sys.exit(code)
        error = error.__cause__ or error.__context__


if __name__ == "__main__":
    main()
