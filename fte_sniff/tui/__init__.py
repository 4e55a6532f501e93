"""The screen of `live` and `view`: rows in a table, their numbers, and what one row means.

Nothing else in the program knows Textual, and nothing here knows where rows come from: they arrive
through a `Feed`, polled when it has something or by a timer, and lie in a `RowStore`. Folders and
files mirror the screen:

    +----------------------------------------------------------+
    | title.py       what is watched, where it is kept, state  |
    | table/         the table's head and the rows             |
    |                                                          |
    | panes.py       below it one of these, or none:           |
    |     detail.py      the cursor's row, byte by byte        |
    |     bytes.py       the bytes around it on the wire       |
    |     motors/        each motor at the cursor, or now      |
    |     statistics/    the numbers over all rows             |
    | notices.py     what a key did, what happened to a port   |
    | prompt/        the filter field, the go-to field         |
    | status.py      counts, rates, the place in the rows      |
    | keyline.py     the keys, out of keys.py                  |
    +----------------------------------------------------------+
      help.py        over all of it, out of keys.py as well
      picking.py     over it too: a list from which one thing is picked
      choosing.py    the same for the table's columns

    terminal.py      the terminal under it: its loss, Ctrl-Z, coming back
    outflow.py       text on its way there, for which nobody waits
    app.py           puts it together: what a look at the feed changes, and the end
    rhythm.py        when the feed is looked at
    waking.py        being woken by a feed that has something
    opening.py       what it is opened with, and what the user may choose anew
    hit_count.py     how many rows have what is looked for
    actions/         what the keys do, one topic a file
    keys.py          every key, once
    watched.py       the feed's rows, their numbers, and ways to a row; knows no Textual
    pane.py          what the panes have in common
    abstract.py      methods that are left to derived classes
    braille.py       drawing with dots
    quantities.py    numbers with units in few cells
    sentence.py      a sentence in few lines, its start and end kept
    fitting.py       text to a width in cells
    colourless.py    the screen without colours
    themes.py        the themes that are our own; theme_names.py has the names of all
    language.py      the language of all the texts
    clips.py         what was copied, for terminals that do not take it
"""
