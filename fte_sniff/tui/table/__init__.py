"""The table of rows: a view of a store that draws only the rows one can see.

viewport   which rows are in view, the cursor, follow and pause; knows no Textual
look       how the user wants the table to look
columns    single columns: head, width, the text of a value
cells      the text of single cells; knows no columns
ports      short names of ports
layout     which columns stand side by side
palette    colours by kind and by status, for dark and for light themes
painter    a row to a strip of styled text
marks      the rows that the user marked
window     what is in view: rows, their signs, and what their times count from
scale      the scroll bar's measure
scrolling  the scroll bar and the mouse wheel
header     the line of column names
widget     the widget: keys and mouse to the viewport, the store's rows to the painter
"""
