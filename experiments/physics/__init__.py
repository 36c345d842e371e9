"""Validation of the simulator by theory, finer meshes, other simulators and scans of drapes."""
