"""Many drapes at once on an accelerator, in PyTorch: :func:`sim.batched.drapes.drape_batch`.

Drapes of one triangulation take the same steps as on the CPU, all in double precision. Element-wise
work is vectorised over elements and drapes, linear systems are factored front by front
(:mod:`sim.batched.solver`). A step takes at least 12 ms for its launches alone: that is why batches
are large, and are kept full (:mod:`sim.batched.newton`).

The factors of 256 drapes of a disc of 300 mm take 1.8 GB, of a square 2.4 GB; the entries of their
Hessians, before they are added up, 0.9 GB; a drape that waits, with its constants, 1 MB.
"""
