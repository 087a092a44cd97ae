"""The denoisers of Guided Motion Diffusion and of its transformer baseline, and the evaluator that
they are measured by, in PyTorch, for comparison."""
