"""Calibration: cameras and rigs from boards, and a rig's drift from the footage itself."""
