"""The table of rows.

Modules:

    columns   Visible columns and widths.
    painter   Rows to styled strips.
    theme     Palettes, themes, NO_COLOR.
    viewport  Visible range, cursor, marks.
    widget    RowTable widget: scroll, header.
"""
