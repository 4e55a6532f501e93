"""Connects inputs to outputs: a capture to its recording and view, files to views and exports.

Modules:

    capture_process  Child process: read ports, frame, record.
    control          The plan, the state and the pipes of a capture process.
    doctor           The checks of `doctor`: machine, ports, line.
    jobs             The same function over groups of files, in processes or on a cluster.
    measured         Count recordings table by table; public check(), stats(), findings().
    files            The recordings that paths name.
    feeds            A thread reads the items of a view; FileFeed, playback.
    following        Follow a recording that another program writes, across its files.
    framing          Chunks of several ports as rows in the order of time: logs, raw bytes.
    inputs           Recordings, logs, raw bytes, pipes; InputReading: their items, merged by time.
    live_session     LiveSession: start, poll, stop.
    merge            Merge: the items of several streams in the order of time.
    notes            Notes on rows beside the recording.
    save             Save rows of a session in any format.
    scan             Recordings as polars tables: public scan() and read().
    stats_json       Statistics as a JSON object.
"""
