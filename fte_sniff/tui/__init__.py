"""The screen: the only package that imports Textual.

```
 title          what is captured, whether it is recorded, the mode
 strip          the four motors: state, target, feedback, answers
 table | page   rows, and one page about them: row, motors, streams, findings
 status         numbers, or the news until esc
 footer         the keys that act now
```

What is shown is a function of a slice of the rows, or of one growing array of their indices.

Modules:

    app         Composes the screen, polls the feed, runs the commands, ends.
    cells       Values of rows as text, in columns and their widths.
    commands    The keys and what they run.
    curves      Curves in braille characters.
    detail      The page about the cursor's row.
    examine     The search for findings in the rows so far.
    export      Copy rows, save rows and pictures.
    filters     The filter in effect and those before; the columns.
    find        Keys that lead to a row.
    findings    The page of findings.
    help        The help pages.
    line        The line on which the user answers what a key asks.
    motors      The page of motors.
    notes       Marks and notes on rows.
    options     How the screen begins.
    pages       The pane, and what its pages have in common.
    painter     Rows as styled lines.
    parts       What the parts that answer keys share.
    search      A search: a filter whose rows are gone to.
    shown       The rows that are shown, and the events between them.
    status      The title and the status line.
    streams     The page of streams.
    strip       The motor strip.
    table       The table of rows.
    terminal    Textual's driver, adapted.
    typed       Keys act in the order in which they come.
    view        A feed, its rows, and the span that is looked at.
    viewport    The window onto the shown rows.
"""
