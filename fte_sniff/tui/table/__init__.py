"""The table of rows: a view of a store that draws only the rows one can see.

viewport   which rows are in view, the cursor, follow and pause; knows no Textual
layout     which columns there are, how wide, and the text of each cell; knows no Textual
palette    colours by kind and by status, for dark and for light themes
painter    a row to a strip of styled text
header     the line of column names
widget     the widget: keys and mouse to the viewport, the store's rows to the painter
"""
