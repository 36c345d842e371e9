"""Captures of real drapes, and datasets of simulated drapes.

- ``captures``: folders of depth images, scans: reading, checking, cutting out the cloth;
- ``render``: depth images of simulated drapes with the noise of sensors; whole synthetic scenes;
- ``fabrics``: measured fabrics, the prior fitted to them, nuisances of specimens;
- ``dataset``: plan, simulation and storage of a dataset's drapes.
"""
