"""The protocol: frame table, framer, rows, explanations. No I/O and no clock.

Modules:

    dissect     Explain a row: its bytes field by field.
    columns     The column table; values as text.
    framer      Framer: chunks in, rows out; times and silence.
    islands     Frames in step and the gaps between them.
    gap         How gaps are divided into frames, damage and noise.
    candidates  Spans that may have been one frame, and their scores.
    rows        Rows: the one container, as numpy columns; a row.
    items       Chunks, port events, gaps.
    spec        The frame table: kinds, fields, faults, constants; encodes a frame.
"""
