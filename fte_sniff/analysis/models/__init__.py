"""What rows mean together: models that rows are fed to, and that answer at any time.

They must not know who asks, nor a clock: now is the time of the last row.

    bench           what the user says about the set-up that no row tells
    addressing      which rows are commands to a motor, which are feedback from it
    following       the models of the screen, fed from a store as it grows:
        motors          each motor's target, present values, flags, rates and answers
        pairing         which feedback answers which command
        traces          speeds and positions over time
        statistics      rates, periods, silence, use of the line, faults over time
    survey          numbers over whole inputs:
        streams         frames of one kind and motor on one port: periods, ranges
        port_run        one wire: how full, how long silent, what happened to its port
        fault_counts    which faults, on which port, when first and last
        flags_seen      which flag bits, how often, and when
        answers         how each motor was answered for
"""
