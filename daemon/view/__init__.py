"""The live view: a process of its own that shows a daemon, or a recording, in the browser."""
