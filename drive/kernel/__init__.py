"""The compiled control cycle of one axis record; `cycle` calls the blocks in order."""
