"""Filter, statistics and models: no screen and no file.

Modules:

    counters      Numbers over rows: durations, recent values, series over time.
    dataframe     Rows to polars DataFrame, and a search for text in it.
    events        Events of trouble, counted by window of time.
    facts         Commands and their answers; streams of frames; facts of rows that depend on other
                  rows: answers, the motor of damage, the frame before.
    feed          The feed of a view: rows as they come, and the state of their source.
    filter        The filter language: SQL boolean expressions over the row columns.
    findings      Findings: the spans of time in which something is wrong.
    line_condition  Condition of a line: sound, damaged, silent, low, text, unreadable.
    measures      Measures of rows, and the table of them; rules compare them with numbers.
    model         Changes between rows; what all models share; counts and rates of rows.
    motors        The motors: state, statistics, and events over time.
    plots         The data of plots: targets and feedback of the motors, and their usual range.
    rules         Rules about rows, and their verdicts: pass, fail, or not covered.
    statistics    Statistics of ports, streams, faults and motors, over one or more inputs.
    time_text     Times and durations that a user types.
    whole         The same analyses as functions over columns; takes the place of the above.
"""
