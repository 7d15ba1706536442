"""Policies that were trained: their files, the network they are, and the actions they correct."""
