"""The command line: one file a command; heavy imports only inside the command that needs them.

Nothing below may import from here. Data goes to stdout, everything else to stderr; each error is
one line, and the exceptions carry the exit codes (0 done, 1 a check says no, 2 usage or input
text, 3 port, 4 file).

    main            the group of commands and the last handler of every error
    live, bridge    capture, record and watch
    view            the screen on files
    decode, stats   files to rows, and to numbers
    hex, encode     single frames
    repair, simulate, ports, doctor

What they stand on:

    options/        what commands have in common on the command line and in the settings file
    capturing/      the run of a capture
    inputs/         files and standard input, opened and read through a filter
    outputs/        where rows and numbers go
    streams/        standard streams and signals: what is said there, how a command hears of its end
"""

from fte_sniff.cli.main import main

__all__ = ["main"]
