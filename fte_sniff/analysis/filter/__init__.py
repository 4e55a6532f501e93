"""The filter language: SQL boolean expressions over the row columns.

Modules:

    compiler     Compiler from filter terms to polars expressions: types, values, conditions.
    completion   Completions of a filter at the cursor.
    parser       Lexer and recursive-descent parser of filters.
    row_filter   RowFilter: a compiled filter, applied to rows.
    terms        Terms, functions, error messages and help text, filters made from cells; needs no
                 polars.

A new function, such as `round`, is one entry of `terms.FUNCTIONS`.

The parser is our own, not sqlglot 30.3, which was tried with its MySQL dialect. It parses all 130
filters of the tests, but also comments, casts, aliases, several statements, and 90 of the 112
mistakes, so that its tree needs a second check. It drops backslashes in texts (`port ~ '\\d'`),
gives no position for an unclosed quote, and raises RecursionError for 100 brackets. Its import
takes 60 to 110 ms, that of parser, compiler and terms 25 ms: `decode --filter` with it is 7 to
12 % slower.
"""
