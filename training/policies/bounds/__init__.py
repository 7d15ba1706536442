"""Certified bounds: what no controller can do better, whatever it knows, in an episode drawn."""
