"""A commissioning tool in the browser, for a drive on a machine that runs in real time.

`session.Session` is the panel without a browser: commands in, snapshots and traces out.
`clock.Clock` lets it run against the wall clock in a thread of its own. `pages/` are thin views on
both, made with NiceGUI; `server.serve` shows them on the loopback.
"""
