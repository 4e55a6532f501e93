"""The command line: one module per command; exit codes.

Modules:

    bridge             `fte-sniff bridge`: sit between a host program and the
                       controller, record and watch both.
    capture_command    Run a capture with screen or plain lines.
    decode             `fte-sniff decode`: recordings, raw bytes and hex text
                       to rows in a form that others read.
    doctor             `fte-sniff doctor`: what is wrong with this set-up,
                       and the command that mends it.
    encode             `fte-sniff encode`: a frame's bytes from its values,
                       one subcommand a kind of frame.
    hex                `fte-sniff hex`: bytes that somebody pasted, taken
                       apart at once.
    input_files        Input arguments to session inputs.
    live               `fte-sniff live`: capture a port, record it, and watch
                       it.
    main               The group of commands, and how every error ends: one
                       line, and an exit code.
    options            Shared click options and parameter types.
    output             Output path, format, overwrite, closing summary.
    ports              `fte-sniff ports`: which serial ports there are.
    recording_options  Options of a recording and the plan made of them.
    repair             `fte-sniff repair`: a damaged recording to a whole
                       one.
    settings           Settings file and environment.
    simulate           `fte-sniff simulate`: a controller on a pseudo-
                       terminal, to develop against.
    stats              `fte-sniff stats`: the numbers over files, for people
                       or as one JSON object.
    stats_json         Statistics as JSON.
    stats_report       Statistics as text.
    streams            Signals, stdout, stderr messages.
    view               `fte-sniff view`: the screen of `live` on files.
"""

from fte_sniff.cli.main import main

__all__ = ["main"]
