"""What photographs show: reading of their files, cloth cut out of the ground, printed markers."""
