"""Fields at the bottom that ask for a line of text: the filter, and where to go.

history   the lines given before
field     one field: checks while one types, gives the line or gives up
complete  the rest of a name or word of the filter's language
filter    the field for a filter
search    the field for what is to be found in the rows
save      the field for the file that rows are saved to
preparing what these need, loaded while one begins to type
goto      the field for a row, a time, or a distance in time; and what such a text means
"""
