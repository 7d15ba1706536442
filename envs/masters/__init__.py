"""Masters: what commands a machine."""
