"""Hex as people paste it and log it, to chunks with their times.

It must not know what values the bytes tell: headers of frames help to see where bytes begin on a
line, and a framer whether the log's directions fit. A line at a time, from the outside in:

    hex_log       HexLog: a log as chunks, with the times and directions that it tells
    log_clock     which moment a line's time is
        day_order     does 2/8/2024 begin with its day or its month?
    text_lines    text of whatever encoding, to lines
    pastes        which form a line has, and so where its bytes stand:
        headed_lines  what stands in front of the bytes, and above them:
            code          words of source code around the bytes
            headings      lines that say when those below came
            line_head     a time and a direction
            line_time     how times are written
            lone_times    lines with nothing but a time, or the beginning of one
            written_rows, strace, analyzers, comma_rows, ros
                          own_lines: forms that only one program has
        dumps         lines of a hex dump, each a dump_line; address_run: which follows which
        line_numbers  numbered lines
        fronts        what stands before the bytes and may be none
        decimals      hex or decimal?
        words         words beside frames, which are no hex
    pasted_line   a line on its way to its bytes
    hex_text      the digits of one line
"""
