"""The command line, the demo, pictures, benchmarks; later policies and training."""
