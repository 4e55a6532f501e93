"""The table of rows.

Modules:

    columns   Columns, their widths and cells, and the layout for a window.
    painter   Rows as lines of styled segments, and signs in the scroll bar.
    theme     Colours under each theme, and NO_COLOR.
    viewport  Visible range, cursor, follow and pause; marked rows.
    widget    The table widget and its header line.
"""
