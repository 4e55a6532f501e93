"""The command line: one file a command; heavy imports only inside the command that needs them.

Nothing below may import from here. Data goes to stdout, everything else to stderr; each error is
one line, and the exceptions carry the exit codes (0 done, 1 a check says no, 2 usage or input
text, 3 port, 4 file).

    main        the group of commands and the last handler of every error
    live, bridge    capture, record and watch; both stand on
        capturing           the options they share, and the run of a capture
        recording_options   how often a recording is flushed, what of it is kept
        plain               lines instead of a screen
    view            the screen on files
    decode, stats   files to rows, and to numbers; these and `view` stand on
        inputs      how files are named, and opened; each is one_input
        spans       `--from` and `--to`
        reading, batches    rows through a filter, many at once, and what is known of them then
        outputs     where rows go: standard output or a new file
        summary     the line that is left on standard error
        stats_page, stats_document, text_table   numbers for people, and as JSON
    hex, encode     single frames
    repair, simulate, ports, doctor
    settings, remembered    the settings file, and how what is chosen on a screen gets there
    filtering, keeping, units, paths, seconds    `--filter`, `--keep-rows`, turns, names, times
    signals, telling, stdout    how a command that runs on hears of its end, and says what happens
"""

from fte_sniff.cli.main import main

__all__ = ["main"]
