"""Movies to arrays and back; the only home of av."""
