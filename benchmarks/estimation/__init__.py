"""What a drape determines, and how well network and refinement estimate it."""
