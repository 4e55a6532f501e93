"""A capture in a process of its own, and the view's end of it.

It must not know what shows the rows.

    plan       what a capture is to do: the ports, the recording, when to end
    messages   what the capture process tells the process of the view
    process    the capture process: what it opens, what it obeys, how it ends
    run        within it: ports -> framers -> one order -> recording, and rows handed to the view
    ordering   the rows of several ports on one time line
    wiring     wires that carry what the other one should
    outbox     the bounded way out of the capture process, so that no view can hold it up
    told       what a view knows of a capture by now
    seams      what stands between the rows that a view gets: missing ones, another speed
    live       the view's end of a capture process
"""
