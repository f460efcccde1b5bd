"""The only room that sees the daemon and the plants together: runs, demo, judge, reports."""
