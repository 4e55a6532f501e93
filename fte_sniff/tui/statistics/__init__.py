"""The pane of statistics: how full the wires are, how even the frames come, what goes wrong when.

page     the numbers as lines of text
widget   the pane
"""
