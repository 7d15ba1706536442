"""Views of a machine: pictures, channels and decoration."""
