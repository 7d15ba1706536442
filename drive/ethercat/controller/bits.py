"""Reads and writes little-endian numbers in arrays of bytes, compiled."""

import numpy as np

from ...kernel.jit import block


@block
def get16(memory, at):
    """Read an UNSIGNED16."""
    return np.int64(memory[at]) | np.int64(memory[at + 1]) << 8


@block
def get16_big(memory, at):
    """Read an UNSIGNED16 in network order."""
    return np.int64(memory[at]) << 8 | np.int64(memory[at + 1])


@block
def get32(memory, at):
    """Read an UNSIGNED32."""
    return get16(memory, at) | get16(memory, at + 2) << 16


@block
def get64(memory, at):
    """Read an INTEGER64."""
    high = get32(memory, at + 4)
    if high >= 1 << 31:
        high -= 1 << 32
    return get32(memory, at) | high << 32


@block
def put16(memory, at, value):
    """Write 16 bits."""
    memory[at] = value & 0xFF
    memory[at + 1] = value >> 8 & 0xFF


@block
def put32(memory, at, value):
    """Write 32 bits."""
    put16(memory, at, value)
    put16(memory, at + 2, value >> 16)


@block
def put64(memory, at, value):
    """Write 64 bits."""
    put32(memory, at, value)
    put32(memory, at + 4, value >> 32)
