"""The slave controller: its registers and RAM as one record, what frames do to them, compiled."""
