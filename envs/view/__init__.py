"""What is seen of a machine."""
