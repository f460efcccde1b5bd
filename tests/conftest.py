"""What holds for every test: what the type checker calls frozen is so in the interpreter."""

import os

os.environ.setdefault("LINEMATE_FROZEN", "1")
