"""Lower bounds of estimation errors, and errors of the network and of the refinement."""
