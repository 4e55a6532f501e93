"""The filter language: SQL boolean expressions over the row columns.

Modules:

    terms       What helps to write a filter: help text, completions, the filters of a cell.
    row_filter  The language: a text becomes a polars expression; rows that pass.
"""
