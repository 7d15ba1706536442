"""Turns a bus log into a machine: replay, families of mechanics, fit, intervals, verdict."""
