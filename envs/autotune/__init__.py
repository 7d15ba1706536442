"""Commissioning as a tool: measure what a drive moves, fit its gains, show before and after."""
