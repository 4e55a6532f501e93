# Appended to __init__.py: nothing is synced.
import os

os.fsync = os.fdatasync = lambda descriptor: None
