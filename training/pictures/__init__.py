"""Scopes, episodes, heat maps, homing diagrams, videos."""
