"""What differs from episode to episode: randomised parameters and injected faults."""
