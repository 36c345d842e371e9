"""Commands around the simulator."""
