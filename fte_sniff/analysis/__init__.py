"""What can be asked of rows: columns, filter, running numbers, and the store behind the screen.

This package knows no screen and no file: rows come in, answers go out. From the bottom up; each
imports only from those above it:

    line/          whether a line is sound, judged by its bytes
    columns/       many rows side by side, in numpy arrays and polars frames
    filter/        which rows are wanted, in one line of text
    store/         a bounded run of rows with a filter on top, and what is looked for in it
    accumulators/  one number after another, kept in little memory
    models/        what rows mean together: motors, answers, rates, faults
"""
