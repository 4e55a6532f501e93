"""Analyses as functions over columns, without state: no screen and no file.

Modules:

    relations   Which rows belong together: runs, the frame before, answers, the motor of damage.
    table       Rows with the numbers that the analyses group and add up.
    segments    A stream in tables, and the sum of what is counted in each.
    durations   Durations counted by bin, so that percentiles add up.
    statistics  Statistics of ports, streams, faults and motors.
    events      Events of trouble, counted by window of time.
    spans       The spans of time in which bad windows are more frequent than elsewhere.
    findings    The spans of time in which something is wrong, ranked.
    check       Measures, rules and verdicts.
    compare     What changed between two recordings: counts by block of time, changes, sentences.
    motors      The motors at a row: values, answers, and which one is in trouble.
    plots       Values over time as minimum and maximum in columns of a span.
    store       The rows of a screen by index, and those that a filter shows.
    filter      The filter language: SQL boolean expressions over the row columns.
    line_condition  Condition of a line: sound, damaged, silent, low, unreadable.
    time_text   Times and durations that a user types.
    dataframe   Rows to polars DataFrame.
    feed        The feed of a view: rows as they come, and the state of their source.
    tally       Counts of rows by fault, the time that they span, and the rate of frames.
"""
