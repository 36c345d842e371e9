"""The service: requests (app), what is uploaded (uploads), estimates under way and finished (jobs),
and what a worker process does for one (work).
"""
