"""The service: requests (app), who may send them (access), pages, limits, uploads (received files,
forms), fabrics and results (database), the zip of all (archive), estimates under way (jobs), and
what worker processes compute and write (work, exports).
"""
