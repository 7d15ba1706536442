"""Trainings: stable-baselines3 on our vectors, checkpoints, evaluation while it learns."""
