"""Many drapes at once: by worker processes on a CPU, as batches on a GPU."""

from sim.batch.drapes import drape_batch

__all__ = ["drape_batch"]
