"""The estimate of a fabric, and the files that hold it."""
