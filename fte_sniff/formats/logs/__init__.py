"""Logs of other tools: the frames show where the bytes are. See `docs/logs.md`.

Modules:

    reader    LogReader: the bytes of a text, whose kind a sample decides; plain hex, own rows.
    layout    A log with a layout: what a sample decides, and from its lines to bytes.
    shapes    Lines that look the same, read at once (numpy).
    evidence  How programs write bytes; frames, directions and lanes in a sample.
    times     The table of time forms, where lines have their times, and their clock.
    text      Text of any encoding as lines; what every kind of log has.
"""
