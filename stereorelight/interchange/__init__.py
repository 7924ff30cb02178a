"""Rigs, cameras and lights in and out of files and other packages."""
