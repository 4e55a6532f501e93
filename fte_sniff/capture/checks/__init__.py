"""What can be wrong with a machine and its ports, looked at without opening one.

finding   what a check says: how bad, of what, and the way out
machine   containers, virtual machines, programs that take adapters away, the clock
device    one port: permission, who holds it, its latency
"""
