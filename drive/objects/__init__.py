"""What a master may read and write: the object dictionary, its hooks, what is stored."""
