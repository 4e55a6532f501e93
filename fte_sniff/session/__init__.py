"""The one place that wires a source to a recording and to a view.

It must not know what shows the rows, nor how any of the rooms below does its work.

    capturing/   a capture, in a process of its own, and the view's end of it
    files/       files that are read: as the feed of a view, and as tables
    saving/      rows of a view to a new file
    doctor/      a look at machine, folder and ports, and at what one line carries

A capture runs in a process of its own. A slow, stopped or killed view costs it no byte, no
timestamp and no file; only "stop" goes back up, and a view that is gone means the same.
"""
