"""Depth to position and normals on the original plate."""
