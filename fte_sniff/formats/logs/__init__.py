"""Logs of other tools: the frames show where the bytes are. See `docs/logs.md`.

Modules:

    reader        LogReader: the bytes of a log, whose kind a sample of its lines decides.
    text          Text of any encoding as lines of UTF-8 bytes; very long lines in segments.
    plain         Logs without other text: plain hex, and rows that this program wrote.
    forms         The forms × separators table: how programs write bytes, as extractors.
    evidence      Frames, directions and lanes in a sample, and the scores of extractors.
    layout        What a sample decides: extractor, lanes, times and labels.
    times         The table of time forms, where lines have their times, and their clock.
    log_form      What a log is read as: its kind, and the bytes of its streams.
    evidence_log  A log with a layout: from its lines to the bytes of its streams.
    shapes        Lines that differ only in digits, read at once by numpy.
"""
