"""Connects inputs to outputs: a capture to its recording and view, files to views and exports.

Modules:

    capture_process  Child process: capture, record, send batches.
    capture_state    Messages of the capture process and the state folded from
                     them.
    doctor           The checks of `doctor`: machine, ports, line.
    framer_hash      Hash of the framer's sources, for setup.py and doctor.
    inputs           Recordings, logs, raw bytes and standard input, read
                     through a filter, with the gaps found.
    live_session     LiveSession: start, poll, stop.
    port_merge       Order rows of several ports; detect swapped wiring.
    replay           ReplaySession over files with paging.
    save             Save rows of a session in any format.
    scan             Recordings as polars tables: public scan() and read().
    worker_process   Start another process of this program, with a pipe to it.
"""
