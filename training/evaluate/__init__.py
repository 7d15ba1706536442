"""Evaluates policies and methods: episodes, metrics, comparisons, results."""
