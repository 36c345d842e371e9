"""Captures of real drapes: reading, checking, segmentation."""
