"""Fabrics, datasets of their drapes, cameras, captures and sensors."""
