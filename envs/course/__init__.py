"""Exercises in drive control, judged by the behaviour of the drive, in the panel and in Python."""
