"""What can be asked of rows: columns, filter, running numbers, and the store behind the screen.

This package knows no screen and no file: rows come in, answers go out. To read it, in this order:

    packing         rows in a numpy array, and back
    fields          kinds and field values out of many rows at once
    side_by_side    what rows side by side are
    plain           where runs of plain frames stand in many bytes
    bulk            many bytes to columns, at the machine's speed
    table           rows to a polars frame with the contract's names, in the smallest types
    columns         such a frame made wide, as the filter computes with it
    filter          the filter
    filter_help     what people are told of its language
    filter_tokens   its text cut into words and signs; errors that point at a place
    filter_cursor   a place among them, and what is said of one out of place
    filter_terms    what a part of it is
    filter_bytes    what a pattern of bytes means
    filter_values   what a value stands for beside a field
    filter_meaning  what parts mean together
    filter_grammar  in what order parts may stand
    moments         how people write times, here and elsewhere
    filter_cells    filters that the cells of one row stand for
    completion      what may stand next in a filter being typed
    tally           counts and rates
    counting        the same of rows side by side
    feed            what a view asks of whatever brings it rows
    search          a text or bytes, looked for in rows
    search_texts    what each row tells, as polars expressions
    block           so many rows side by side, and which of them a filter wants
    paging          which blocks lie in memory, where their rows can be read again
    store           a bounded run of rows with a filter on top
    bench           what the user says about the set-up that no row tells
    following       the models of what rows mean, fed from a store as it grows:
        motors          each motor's target, present values, flags, rates and answers
        pairing         which feedback answers which command
        traces          speeds and positions over time
        envelope        a value over time in bounded memory; no spike is lost
        statistics      rates, periods, silence, use of the line, faults over time
        durations       how long things took, as a histogram
        counts          how many of each sort came when
        recent          the last few of many numbers
        addressing      which rows are commands to a motor, which are feedback from it
        streams         frames of one kind and motor on one port: periods, ranges
        port_run        one wire: how full, how long silent, what happened to its port
        fault_counts    which faults, on which port, when first and last
        flags_seen      which flag bits, how often, and when
        answers         how each motor was answered for
        survey          all of these over whole inputs
    line_verdict    whether a line is sound, judged by its bytes
    uart_model      what a UART hears of a line at another baud or polarity
"""
