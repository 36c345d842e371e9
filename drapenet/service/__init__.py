"""The service: requests (app), uploads (uploads), the queue and where results lie (jobs), and
what a worker process computes and writes (work).
"""
