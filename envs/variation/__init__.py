"""Variation of episodes: randomised parameters and injected faults."""
