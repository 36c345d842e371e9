"""Many drapes at once on an accelerator, in PyTorch: :func:`sim.batched.drapes.drape_batch`.

Drapes of one triangulation take the same steps as on the CPU, all in double precision. Element-wise
work is vectorised over elements and drapes, linear systems are factored front by front
(:mod:`sim.batched.solver`).

An iteration of all drapes takes at least 12 ms for its launches alone: that is why batches are
large, and the last few drapes of a minimisation are not waited for. The factors of 256 drapes of a
disc of 300 mm take 1.8 GB, of a square 2.4 GB; the entries of their Hessians, before they are added
up, 0.9 GB.
"""
