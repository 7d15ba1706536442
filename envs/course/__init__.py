"""Exercises in drive control, judged on what happened: in the panel, in Python and by a command."""
