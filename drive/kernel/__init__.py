"""What is compiled: one record in, one control cycle on; `cycle` has the order of the blocks."""
