"""A log of a bus becomes a machine: replay, families of mechanics, fit, intervals, verdict."""
