"""CC-MotionGen's network, decoder and end-to-end training step in PyTorch, for comparison."""
