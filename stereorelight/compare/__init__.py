"""Results against truth, in the figures that the field knows."""
