"""What talks to a daemon from outside, through the command protocol alone."""
