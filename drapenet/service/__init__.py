"""The service: requests (app), pages, limits, uploads, fabrics and results (database), estimates
under way (jobs), and what worker processes compute and write (work, exports).
"""
