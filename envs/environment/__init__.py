"""The environments of Gymnasium: one, a vector on cores, a vector on a device, their registry."""
