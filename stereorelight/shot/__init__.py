"""The shot file, and the steps of a run in their order: what changed is done again, what stands is kept."""
