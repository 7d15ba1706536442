"""The pages of the panel: each draws a snapshot and sends what is clicked to the session."""
