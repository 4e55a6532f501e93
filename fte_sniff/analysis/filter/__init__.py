"""The filter language: SQL boolean expressions over the row columns.

Modules:

    completion  Completions of a filter at the cursor.
    terms       Help text of the language, and the filters of a cell.
    row_filter  The language: a text becomes a polars expression; rows that pass.
"""
