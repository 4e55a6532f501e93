"""Filter, statistics, models and the row store. Knows no screen and no file.

Modules:

    baud_guess    Is a line at the wrong baud rate.
    counters      Counters, rates, histograms over batches.
    dataframe     RowBatch to polars DataFrame.
    feed          Follow a growing store; gaps and baud changes.
    fields        Value fields of a frame: names, types, decode from raw.
    filter        The filter language: SQL boolean expressions over the row
                  columns.
    live_models   Models that follow a growing store, with checkpoints of motor
                  state for any row.
    motor_stats   Flags seen and answer times.
    motors        Motor state from commands and replies.
    row_store     Append-only row store, blocks, paging, filtered view.
    search        Find next/previous and count hits.
    search_frame  Search texts with polars.
    statistics    Counts, rates, faults per port and direction.
    summary       All statistics over a source (`report` is the HTML page of a
                  later command).
    time_text     Parse times and durations that a user types.
    traces        Min/max envelopes of values over time.
"""
