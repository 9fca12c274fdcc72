"""Simulated studies of how good the estimates are."""
