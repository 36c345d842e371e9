"""The views of a capture: camera pose, turns, radial map, checks."""
