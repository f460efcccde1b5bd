"""Rules of a task's plan: what each waypoint needs before any robot moves."""
