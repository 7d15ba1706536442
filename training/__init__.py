"""Learning, judging, pictures, benchmarks, and the command line."""
