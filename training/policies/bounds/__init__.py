"""Certified bounds: what no controller can exceed in a given episode, whatever it knows."""
