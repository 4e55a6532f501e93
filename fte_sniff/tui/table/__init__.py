"""The table of rows.

Modules:

    columns       Columns, their widths and cells, and the layout for a window.
    overview_bar  Signs in the scroll bar: where faults, marks and gaps are.
    painter       Rows as lines of styled segments.
    theme         Colours under each theme, and NO_COLOR.
    viewport      Visible range, cursor, follow and pause; marked rows.
    widget        The table widget and its header line.
"""
