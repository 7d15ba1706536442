"""Explains frames in the terms of CiA 301, 305 and 402."""

from .decoder import Decoder

__all__ = ["Decoder"]
