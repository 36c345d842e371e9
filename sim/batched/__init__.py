"""Many drapes at once on an accelerator, in PyTorch: :func:`sim.batched.drapes.drape_batch`.

Drapes of one triangulation take the same steps as on the CPU, all in double precision. Element-wise
work is vectorised over elements and drapes, linear systems are factored front by front
(:mod:`sim.batched.solver`). A step takes at least 12 ms for its launches alone: that is why batches
are large, and are kept full (:mod:`sim.batched.newton`).
"""
