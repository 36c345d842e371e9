"""Kinds of measurements of a fabric: how each is read, shown and recorded."""
