"""What the keys do, one topic a file; the screen is all of them together.

parts     what actions work on: the widgets and the watched rows
filtering which rows are shown
searching rows that have a text or bytes
seeking   ways to a row: a place, a time, a fault
marking   rows set apart: marks, a selection
looking   how rows are shown: pause, times, columns, colours, panes, help
taking    rows out of the screen: to the clipboard, to a file
leaving   what was begun is ended
"""
