"""The denoisers of Guided Motion Diffusion and of its transformer baseline in PyTorch, for
comparison."""
