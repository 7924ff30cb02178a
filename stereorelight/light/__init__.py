"""Lights, and the layers that they add to a plate."""
