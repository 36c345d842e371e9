"""Many drapes at once on an accelerator, in PyTorch: :func:`sim.batched.drapes.drape_batch`.

Drapes of one triangulation take the same steps as on the CPU, all in double precision. Element-wise
work is vectorised over elements and drapes, linear systems are factored front by front
(:mod:`sim.batched.solver`).

Estimate of an iteration of 256 drapes on an H100 (3 TB/s; matrix products of this size at 5
TFLOP/s, factors and substitutions of small matrices at 0.3 TFLOP/s), for a disc of 300 mm with
4 047 unknowns, 1 359 triangles, 1 952 pairs of them and 93 066 non-zeros:

=============  =========================================================  ========  ========
Part           Per drape                                                  Launches  256
=============  =========================================================  ========  ========
Evaluation     24 MB moved                                                     320  2 ms
Hessian        101 MB moved                                                    690  9 ms
Factor         202 MFLOP, 9 of them in small factors, 87 MB moved              270  26 ms
Solution       17 MB moved                                                      70  2 ms
=============  =========================================================  ========  ========

An H200 took 3, 9, 15 and 2 ms. A dense factor would take 22 GFLOP. With 1.2 factors and 1.5
evaluations, an iteration takes 47 ms, and at least 12 ms for few drapes, as launches take 7 µs
each: that is why batches are large, and the last few drapes of a minimisation are not waited for.
The factors of 256 drapes take 1.8 GB
(square of 300 mm: 2.4 GB), the entries of their Hessians, before they are added up, 0.9 GB.
"""
