"""The realistic world as scenarios: its rows and their settings of the daemon."""
