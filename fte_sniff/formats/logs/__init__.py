"""Logs of other tools: the frames show where the bytes are. See `docs/logs.md`.

Modules:

    forms         The forms × separators table: how programs write bytes, as extractors.
    evidence      Frames, directions and lanes in a sample, and the scores of extractors.
    layout        What a sample decides: extractor, lanes, times and labels.
    times         The table of time forms, where lines have their times, and their clock.
    evidence_log  A log with a layout: from its lines to the bytes of its streams.
    shapes        Lines that look the same, read at once.
    weave         The bytes of two wires in one lane, separated by their frames.
"""
