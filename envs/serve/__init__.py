"""Whole machines from one file, served on their buses: several axes, faults by script."""
