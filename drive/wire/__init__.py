"""The only room that knows sockets, clocks and python-can: buses, logs, a real-time server."""
