"""Many drapes at once on an accelerator, in PyTorch: :func:`sim.batched.drapes.drape_batch`."""
