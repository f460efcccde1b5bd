"""Commands of `linemate` for production: parts, records and their report."""
