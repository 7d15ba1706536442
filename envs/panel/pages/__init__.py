"""The pages of the panel: each draws a snapshot, and sends clicks to the session."""
