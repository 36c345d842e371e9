"""An open benchmark of estimators of bending moduli from drapes; see ``benchmarks/README.md``."""
