"""Filter, statistics and models: no screen and no file.

Modules:

    dataframe     Rows to polars DataFrame, and a search for text in it.
    feed          The feed of a view: rows as they come, and the state of their source.
    filter        The filter language: SQL boolean expressions over the row columns.
    line_condition  Condition of a line: sound, damaged, silent, low, text, unreadable.
    model         Changes between rows; what all models share; counts and rates of rows.
    time_text     Times and durations that a user types.
    whole         Analyses as functions over columns: measures, statistics, findings, motors.
"""
