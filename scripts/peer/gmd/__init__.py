"""The denoisers of Guided Motion Diffusion and of its transformer baseline, and their evaluator, in
PyTorch, for comparison."""
