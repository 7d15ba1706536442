"""Makes drive models from other manufacturers' files and from connected slaves."""
