"""Datasets of simulated drapes for training, and captures of real drapes.

- ``fabrics``, ``prior``: tables of measured fabrics, and distributions fitted to them;
- ``nuisances``, ``sampling``, ``options``: random fabric, specimen and initial state of a drape;
- ``records``, ``workers``, ``generate``: simulation of drapes by parallel processes;
- ``shards``, ``manifest``, ``folder``, ``splits``, ``inspect``: datasets on disk;
- ``cameras``, ``rasterise``, ``rasterise_cpu``, ``render``, ``picture``: depth images and shaded
  images;
- ``sensor``, ``sensor_noise``, ``structured_light``, ``time_of_flight``, ``remap``: sensor noise;
- ``setups``, ``scenes``: simulated captures, segmented to the cloth or of the full scene;
- ``arrays``, ``reading``, ``recordings``, ``frames``: reading depth from files;
- ``board``, ``plate``, ``cutout``: turns of the table, and segmentation of the cloth;
- ``captures``, ``capture``: reading, checking and writing captures; the segmentation command;
- ``scans``: scanned drapes.
"""
