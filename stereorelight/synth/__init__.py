"""Scenes with exact answers, rendered as stereo plates."""
