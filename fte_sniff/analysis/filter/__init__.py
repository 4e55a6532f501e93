"""The filter: one line of text that says which rows are wanted.

It must not know where rows come from or where they are shown. From the text to the rows:

    tokens          the text cut into words and signs; errors that point at a place
    cursor          a place among them, and what is said of one out of place
    terms           what a part of it is
    complaints      what is said of a part that does not fit
    byte_patterns   what a pattern of bytes means
    moments         how people write times, here and elsewhere
    values          what a value stands for beside a field
    joining         parts as one, never too deep or too large
    expressions     what values are made of: fields, numbers, arithmetic, functions
    predicates      what may be asked of values: comparisons, words, patterns
    grammar         in what order parts may stand
    row_filter      RowFilter: all of this, asked of rows
    help            what people are told of the language
    cells           filters that the cells of one row stand for
    completion      what may stand next in a filter being typed
"""
