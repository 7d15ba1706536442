"""A commissioning tool in the browser for drives whose machine runs in real time.

`session.Session` is the panel without a browser: it takes commands and returns snapshots and
traces. `clock.Clock` runs it against the wall clock in a thread of its own. `pages/` are thin views
on both, made with NiceGUI; `server.serve` serves them on the loopback interface.
"""
