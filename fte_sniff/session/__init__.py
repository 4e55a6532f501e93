"""The one place that wires a source to a recording and to a view.

It must not know what shows the rows, nor how any of the rooms below does its work.

    plan       what a capture is to do: the ports, the recording, when to end
    messages   what the capture process tells the process of the view
    process    the capture process: what it opens, what it obeys, how it ends
    run        within it: ports -> framers -> one order -> recording, and rows handed to the view
    ordering   the rows of several ports on one time line
    wiring     wires that carry what the other one should
    outbox     the bounded way out of the capture process, so that no view can hold it up
    live       the view's end of a capture process
    replay     the same for a file that is being read
    packed     a recording's columns to the packed rows of a view
    pages      a recording's rows once more, by their number
    doctor     a look at machine, folder and ports, and at what one line carries
    surroundings, verdicts   its words on the folder and the terminal, and on a line's bytes
    saving     rows of the view to a new file
    sinks      what takes rows for such a file, by its form
    parquet_sink, recording_sink   those of them that need much to be loaded
    tables     recordings as polars tables; `earliest` is where a filter lets them begin

A capture runs in a process of its own. A slow, stopped or killed view costs it no byte, no
timestamp and no file; only "stop" goes back up, and a view that is gone means the same.
"""
