"""Analyses as functions over columns, without state.

Modules:

    timeline   The points of a report's plots.
    line_setup  What the user says about the line and the motors.
    check      Measures, rules and verdicts.
    compare    What changed between two recordings: counts by block of time, changes, sentences.
    findings   The spans of time in which something is wrong, ranked.
    events     Events of trouble, counted by window of time.
    statistics  Statistics of ports, streams, faults and motors.
    durations  Durations counted by bin, so that percentiles add up.
    store      The rows of a screen by index, and those that a filter shows.
    motors     The motors at a row: values, answers, and which one is in trouble.
    plots      Values over time as minimum and maximum in columns of a span.
    segments   A stream in tables, and the sum of what is counted in each.
    table      Rows with the numbers that the analyses group and add up.
    relations  Which rows belong together: runs, the frame before, answers, the motor of damage.
"""
