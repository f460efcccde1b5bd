"""What holds for every test."""

import os
import signal

# What the type checker calls frozen is so in the interpreter.
os.environ.setdefault("LINEMATE_FROZEN", "1")

# A shell ignores SIGINT for what it starts in the background, and children inherit that: the tests
# that interrupt a program would wait for ever.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)
