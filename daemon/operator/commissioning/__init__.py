"""``linemate commission``: the walk through a site's commissioning."""
