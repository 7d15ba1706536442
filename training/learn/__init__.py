"""Trainings by stable-baselines3 on vectors of environments, with checkpoints and evaluations."""
