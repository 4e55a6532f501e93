"""The filter language: SQL boolean expressions over the row columns.

Modules:

    cell_filter  Filter made from a table cell; needs no polars.
    completion   Completions at the cursor.
    lexer        Tokens and token cursor.
    operands     Literals, byte patterns, arithmetic.
    parser       Grammar.
    predicates   Comparisons to polars expressions.
    row_filter   RowFilter: compile and apply.
    terms        Names, types, functions, help and error messages.
"""
