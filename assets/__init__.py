"""Data of the laboratory: MJCF plants and drive models."""
