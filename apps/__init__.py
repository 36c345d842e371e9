"""Command-line programs of the simulator."""
