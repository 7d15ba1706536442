"""The emulated CiA 402 drive: the block diagram of a servo drive, one box a file."""
