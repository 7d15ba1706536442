"""Plants, machines and Gymnasium environments."""

from .linear_axis import LinearAxisParameters, linear_axis
from .machine import Machine

__all__ = ["LinearAxisParameters", "Machine", "linear_axis"]
