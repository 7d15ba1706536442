"""Trained policies: their files, their networks, and corrections of other policies."""
