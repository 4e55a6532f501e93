"""Connects inputs to outputs: a capture to its recording and view, files to views and exports.

Modules:

    capture_process  Child process: its plan and messages; capture, record, send batches.
    doctor           The checks of `doctor`: machine, ports, line.
    file_jobs        Measure many files, one job a file: public check() and stats(); WorkerPool.
    files            The recordings that paths name.
    following        Follow a recording that another program writes, across its files.
    framing          Chunks of several ports as rows in the order of time: logs, raw bytes.
    inputs           Recordings, logs, raw bytes, pipes; InputReading: their rows, merged by time.
    live_session     LiveSession: start, poll, stop; CaptureState.
    merge            Merge: rows of several lanes in one order, with watermarks.
    notes            Notes on rows beside the recording.
    user_state       Places of views and choices of the screen, as JSON of the program.
    replay           ReplaySession over files with paging; playback.
    save             Save rows of a session in any format.
    scan             Recordings as polars tables: public scan() and read().
    stats_json       Statistics as a JSON object.
    worker_process   Start another process of this program, with a pipe to it.
"""
