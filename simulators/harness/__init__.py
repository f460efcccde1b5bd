"""Runs of daemon and plants together: in virtual time, in real time, on a cluster."""
