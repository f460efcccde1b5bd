"""Pure, seeded plants: what really happens in a run; they know no daemon, wire or clock."""
