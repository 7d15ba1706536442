"""Machines one can have: linear axes, gantries, joints of an MJCF, and their commissioning."""
