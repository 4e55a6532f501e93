"""The command line: one module per command; exit codes.

Commands:

    live          `fte-sniff live`: capture a port, record it, and show it.
    bridge        `fte-sniff bridge`: pass bytes between host and controller; record both.
    view          `fte-sniff view`: the screen of `live` on files.
    decode        `fte-sniff decode`: files to text, Parquet, MCAP or raw bytes.
    findings      `fte-sniff findings`: what is wrong, when, and the rows that show it.
    stats         `fte-sniff stats`: statistics over files, as text or JSON.
    compare       `fte-sniff compare`: what changed between two recordings.
    check         `fte-sniff check`: a verdict about files, for acceptance tests and CI.
    report        `fte-sniff report`: one HTML page with plots.
    hex           `fte-sniff hex`: explain pasted bytes.
    encode        `fte-sniff encode`: bytes of a frame from its values.
    simulate      `fte-sniff simulate`: a controller on a pseudo-terminal, for development.
    repair        `fte-sniff repair`: repair a damaged recording.
    decoder       `fte-sniff decoder`: decoders for sigrok and Wireshark.
    ports         `fte-sniff ports`: list the serial ports.
    doctor        `fte-sniff doctor`: faults of the set-up, each with a command that fixes it.
    completion    `fte-sniff completion`: scripts for shells; ports, filters.

What several commands share:

    main          The group of commands, and the message and exit code of each error.
    streams       Standard streams and signals: what ends or delays a command.
    options       Click options and parameter types that do not concern files.
    settings      Settings file and environment.
    input_files   Names of files, FILE arguments, filter and times, inputs, the summary.
    measuring     Measure files here, in worker processes, or on a cluster; print the results.
    capturing     Options, plan and observers of a capture.
    capture_loop  The loop of a capture, for all its observers.
    live_data     Rows for other programs: their options, and UDP datagrams.
    foxglove_server  Rows for viewers over WebSocket.
    report_page   The page of a report, which needs the packages of an extra.
"""

from fte_sniff.cli.main import main

__all__ = ["main"]
