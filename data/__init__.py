"""Drapes of fabrics for networks to learn from, and captures of real ones.

- ``fabrics``, ``prior``: tables of measured fabrics, the distributions fitted to them;
- ``nuisances``, ``sampling``, ``options``: which fabric, specimen and start a drape has, by seed;
- ``records``, ``workers``, ``generate``: from its index to a drape's record, by many processes;
- ``shards``, ``manifest``, ``folder``, ``splits``, ``inspect``: datasets on disk;
- ``cameras``, ``rasterise``, ``rasterise_cpu``, ``render``, ``picture``: depth pictures, and shaded
  ones for people;
- ``sensor``, ``sensor_noise``, ``structured_light``, ``time_of_flight``, ``remap``: their noise;
- ``setups``, ``scenes``: simulated captures, cut out to the cloth or whole;
- ``arrays``, ``reading``, ``recordings``, ``frames``: depth in files of all kinds;
- ``board``, ``plate``, ``cutout``: turns of the table, and the cloth in whole scenes;
- ``captures``, ``capture``: captures read, checked and written; the command that cuts them out;
- ``scans``: scanned drapes of real fabrics.
"""
