"""The command line: one file a command; heavy imports only inside the command that needs them.

Nothing below may import from here. Data goes to stdout, everything else to stderr; each error is
one line, and the exceptions carry the exit codes (0 done, 1 a check says no, 2 usage or input
text, 3 port, 4 file).

    main        the group of commands and the last handler of every error
    inputs      files and standard input as the user names them
    one_input   each of them, to batches of rows
    outputs     where rows go: standard output or a new file
    filtering, keeping    `--filter`, `--keep-rows`
    signals, telling, stdout    how a command that runs on hears of its end, and says what happens
    plain       `live` without a screen
    live, view, decode, hex, encode, simulate, ports    the commands
"""

from fte_sniff.cli.main import main

__all__ = ["main"]
