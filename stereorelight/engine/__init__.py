"""The fused row kernels that stereo, surface, light and synth call; the only home of numba."""
