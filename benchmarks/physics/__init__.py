"""The simulator against theory, finer meshes, other simulators and scans of real drapes."""
