"""Logs of other tools as rows: the frames show where the bytes are. See `docs/logs.md`.

Modules:

    reader        LogReader: the rows of a log, whose kind a sample of its lines decides.
    text          Text of any encoding as lines of UTF-8 bytes; very long lines in segments.
    plain_hex     Hex without any text around it, read strictly.
    own_rows      Rows that this program wrote: tables, CSV and JSON lines.
    forms         The forms × separators table: how programs write bytes, as extractors.
    chance        Whole frames in bytes, and how many there would be by chance.
    evidence      Lanes and scores: which extractor and which runs hold frames.
    layout        What a sample decides: extractor, lanes, times and labels.
    times         The table of time forms, where lines have their times, and their clock.
    labels        Directions and ports that the text around bytes names.
    evidence_log  A log with a layout: groups of lines that are read at once.
    streams       Each direction or port as a stream with its own framer; their rows merged.
"""
