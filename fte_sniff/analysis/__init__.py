"""Filter, statistics, models and the row store: no screen and no file.

Modules:

    counters      Counters over rows: durations, recent values, rates.
    dataframe     Rows to polars DataFrame, and a search for text in it.
    events        Events of trouble, counted by window of time.
    facts         Facts of rows that depend on other rows: answers, the motor of damage.
    feed          Follow a growing store; gaps and baud changes.
    filter        The filter language: SQL boolean expressions over the row columns.
    findings      Findings: the spans of time in which something is wrong.
    landmarks     Port events and gaps between rows; where faults and flags are.
    line_condition  Condition of a line: sound, damaged, silent, low, text, unreadable.
    live_models   Models that follow a growing store, with checkpoints of the motors' state.
    measures      Measures of rows, and the table of them; rules compare them with numbers.
    model         What all models share: observe, merge, copy.
    motor_events  Events of each motor over time: no answer, late answers, damage, flags.
    motor_stats   Statistics of motors: flags and answer times.
    motors        State of the motors, from commands and feedback.
    previous_frames  The frame before of the same port, motor and kind.
    relations     Streams of frames, and what changed between them; commands and their answers.
    row_store     Append-only store of rows in blocks, with a filtered view.
    rules         Parser of rules: a measure of the rows, compared with a number.
    search        Search in a store: the next matching row, and a counter.
    series        Numbers over time in windows, by group: totals, extremes, last values.
    statistics    Statistics of ports, streams and faults.
    summary       Statistics of all rows of one or more inputs.
    tally         Counts of rows by port and faults.
    time_text     Times and durations that a user types.
    timeline      Commands, feedback, flags and faults over time, for reports.
    traces        Targets and feedback of the motors over time, for plots.
    usual_range   Usual range of a quantity, without outliers.
    verdicts      Verdicts of rules about rows: pass, fail, or not covered.
"""
