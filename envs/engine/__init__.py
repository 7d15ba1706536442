"""Drives and MuJoCo in one compiled loop."""
