"""Plate health: what is wrong with a pair of plates, how much, and what to do about it."""
