"""From material parameters to training tensors: fabrics, cameras, pictures, shards."""
