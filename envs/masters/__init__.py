"""Who commands a machine."""
