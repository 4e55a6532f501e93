"""What the keys do, one topic a file; the screen is all of them together.

parts     what actions work on: the widgets and the watched rows
filtering which rows are shown
seeking   ways to a row: a place, a time, a fault
looking   how rows are shown: pause, panes, help
taking    rows out of the screen: to the clipboard
"""
