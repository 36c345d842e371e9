"""The service: requests (app), uploads (uploads), queue and results (jobs), and the task of a
worker process (work).
"""
