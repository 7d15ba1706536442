"""Buses, logs and real-time servers: the only package with sockets, clocks and python-can."""
