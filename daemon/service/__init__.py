"""The process linemated: start-up, links, operators, recording, status."""
