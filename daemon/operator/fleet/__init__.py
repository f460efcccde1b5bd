"""``linemate fleet``: several stations in one table, over zenoh."""
