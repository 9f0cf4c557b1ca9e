"""Simulated sessions: targets, motions and a depth sensor, every frame with its truth."""
