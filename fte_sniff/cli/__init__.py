"""The command line: one module per command; exit codes.

Modules:

    bridge             `fte-sniff bridge`: pass bytes between host and controller; record both.
    capture_command    Run a capture with screen or plain lines.
    capture_loop       The loop of a capture, for all its observers.
    check              `fte-sniff check`: a verdict about files, for acceptance tests and CI.
    check_report       Verdicts as a table, JSON or JUnit XML.
    completion         `fte-sniff completion`: scripts for shells; ports, filters.
    datagrams          Rows of a capture as UDP datagrams.
    decode             `fte-sniff decode`: files to text, Parquet, MCAP or raw bytes.
    decoder            `fte-sniff decoder`: decoders for sigrok, Wireshark and JSON tools.
    doctor             `fte-sniff doctor`: faults of the set-up, each with a command that fixes it.
    encode             `fte-sniff encode`: bytes of a frame from its values.
    extras             Packages of the extras: the command that installs one.
    findings           `fte-sniff findings`: what is wrong, when, and the rows that show it.
    foxglove_server    Rows of a capture for viewers, over WebSocket.
    foxglove_websocket The protocol that viewers speak, and a queue for each.
    hex                `fte-sniff hex`: explain pasted bytes.
    input_files        Input arguments to session inputs.
    live               `fte-sniff live`: capture a port, record it, and show it.
    main               The group of commands, and the message and exit code of each error.
    measuring          Measure files here, in worker processes, or on a cluster.
    options            Shared click options and parameter types.
    output             Format options, JSON for people, and the summary at the end.
    ports              `fte-sniff ports`: list the serial ports.
    progress           Progress of reading files, as a line on standard error.
    recording_options  Options of a recording and the plan made of them.
    repair             `fte-sniff repair`: repair a damaged recording.
    report             `fte-sniff report`: one HTML page with plots.
    report_page        The page of a report.
    service            Messages to systemd; a command for each finished file.
    settings           Settings file and environment.
    simulate           `fte-sniff simulate`: a controller on a pseudo-terminal, for development.
    stats              `fte-sniff stats`: statistics over files, as text or JSON.
    stats_report       Statistics as text.
    streams            Signals, stdout, stderr messages.
    view               `fte-sniff view`: the screen of `live` on files.
"""

from fte_sniff.cli.main import main

__all__ = ["main"]
