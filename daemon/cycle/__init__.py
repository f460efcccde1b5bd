"""One cycle: telegram in, reply out; session, states, watches and sensor health."""
