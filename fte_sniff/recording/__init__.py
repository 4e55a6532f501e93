"""MCAP recordings: write, read, rotate.

Modules:

    chunks         The chunks of a file: by its summary, or by a walk over its records.
    foreign_topic  Serial bytes in topics of other programs.
    metadata       Port facts, recorded gaps and selections as MCAP metadata.
    output_file    The file of a recording: name, lock, identity, refusals.
    reader         Recording: rows, port events and gaps of a file; what could not be read.
    recorder       Recorder: rows in, files out; rotation, retention, gaps on write errors.
    schema         Topics and schemas; one message.
    skeletons      Messages to columns and back: those that differ in numbers only, at once.
    writer         Writers of one recording: a growing file, and a file or pipe in sequence.
"""
