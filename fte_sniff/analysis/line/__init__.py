"""Whether a line is sound, judged by its bytes alone.

It must not know a port, or what is done about it.

    verdict      what a line carries, and what is wrong with it
    uart_model   what a UART hears of a line at another baud or polarity
"""
