"""Analyses as functions over columns, without state; take the place of the modules beside them.

Modules:

    store      The rows of a screen by index, and those that a filter shows.
    motors     The motors at a row: values, answers, and which one is in trouble.
    plots      Values over time as minimum and maximum in columns of a span.
    segments   A stream in tables, and the sum of what is counted in each.
    table      Rows with the numbers that the analyses group and add up.
    relations  Which rows belong together: runs, the frame before, answers, the motor of damage.
"""
