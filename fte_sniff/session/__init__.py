"""Connects inputs to outputs: a capture to its recording and view, files to views and exports.

Modules:

    capture_process  Child process: capture, record, send batches.
    capture_state    Messages of the capture process and the state folded from them.
    doctor           The checks of `doctor`: machine, ports, line.
    fact_stage       Facts and readings of an input's rows: rows wait until they are decided.
    file_jobs        Measure many files, one job a file: public check() and stats().
    following        Follow a recording that another program writes, across its files.
    framer_hash      Hash of the framer's sources, for setup.py and doctor.
    input_reading    InputReading: rows of inputs through a filter, merged by time.
    inputs           Recordings, logs, raw bytes and standard input; Progress of reading them.
    live_session     LiveSession: start, poll, stop.
    log_rows         The rows of raw bytes and logs: streams are framed and merged.
    merge            Merge: rows of several lanes in one order, with watermarks.
    notes            Notes on rows beside the recording, and the place of a view.
    replay           ReplaySession over files with paging; playback.
    save             Save rows of a session in any format.
    scan             Recordings as polars tables: public scan() and read().
    stats_json       Statistics as a JSON object.
    wiring           Detection of swapped or mixed wiring.
    worker_pool      Worker processes as an executor.
    worker_process   Start another process of this program, with a pipe to it.
"""
