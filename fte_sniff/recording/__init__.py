"""MCAP recordings: write, read, repair, rotate.

Modules:

    bulk_writer    Batch writer with packing in a worker.
    foreign_topic  Read an MCAP topic written by other tools.
    mcap           MCAP container I/O, including truncated and damaged files.
    messages       Rows as protobuf messages and back.
    metadata       Port facts, recorded gaps and selection as MCAP metadata.
    output_file    Path choice, existing files, pipes, refusals.
    parallel       Read batches with worker processes.
    row_ranges     Row ranges of a file and how a damaged file is read.
    reader         RecordingReader: public reading interface, several files.
    recorder       Recorder: rows in, files out, gaps on write errors, rotation.
    repair         Repair a damaged recording.
    retention      Rotation and size limits; which old files are deleted.
    sequential     Read rows in order, in one process.
    trigger        Keep rows only around rows that match.
    writer         RecordingWriter: rows to one file.
"""
