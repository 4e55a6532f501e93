"""Prototype: analyses of a whole recording as functions over columns, without state and merging.

Modules:

    relations    Which rows belong together: runs, the frame before, answers, the motor of damage.
    statistics   Statistics of ports, streams, faults and motors.
    check        Measures of rows, rules about them, and verdicts.
    sql          The filter language: SQL conditions, by polars.
"""
