"""One number after another, kept in little memory whatever comes.

They must not know a clock, a screen or a file; and but for the tally, which counts rows, none of
them knows what its numbers mean.

    tally           rows by status, and how many a second
    counting        rows side by side, to a tally
    counts          how many of each sort came when
    recent          the last few of many numbers
    durations       how long things took, as a histogram
    envelope        a value over time in bounded memory; no spike is lost
"""
