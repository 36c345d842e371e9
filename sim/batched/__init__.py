"""Many drapes at once, in PyTorch, on a CPU or a GPU."""
