"""What a run is made of: the cell's files, the family of its controller, variants and plug-ins."""
