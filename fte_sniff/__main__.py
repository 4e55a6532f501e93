"""Entry points: `fte-sniff`, `python -m fte_sniff`, and the processes that the program starts.

While the program is loading, Ctrl-C ends it at once and without a traceback; afterwards the
command line handles it. No code of the working folder is imported, except what Python itself loads
before this module for `python -m`.
"""

# The built-in module behind `signal`, which would take time to import before Ctrl-C is handled.
import _signal as signal  # type: ignore[import-not-found]
import sys


def main() -> None:
    """Load and run the command line."""
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    import gc

    gc.disable()  # until the command is loaded: loading makes no garbage
    try:
        from fte_sniff.cli import main as run

        run()
    except (OSError, ImportError) as error:
        _exit_if_too_many_files(error, "fte-sniff: too many open files; try `ulimit -n 4096`\n")
        raise


def worker() -> None:
    """Load and run a worker process, see `session.worker_process`."""
    try:
        from fte_sniff.session.worker_process import run

        run(int(sys.argv[1]))
    except (OSError, ImportError) as error:
        _exit_if_too_many_files(error)  # the starting process reports it
        raise


def _exit_if_too_many_files(error: BaseException | None, message: str = "") -> None:
    while error is not None:
        # A library that cannot be loaded has no error number, only the text.
        if "Too many open files" in str(error):
            sys.stderr.write(message)
            sys.exit(4)
        error = error.__cause__ or error.__context__


def _leave_working_folder() -> None:
    """Remove the folder that `python -m` puts first on the import path."""
    import os

    try:
        folder = os.getcwd()  # noqa: PTH109
    except FileNotFoundError:
        return
    if sys.path[0] == folder:
        del sys.path[0]
        if __file__ == f"{folder}/fte_sniff/__main__.py":
            sys.path.append(folder)


if __name__ == "__main__":
    _leave_working_folder()
    main()
