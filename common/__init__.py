"""Shared by all commands: errors, files, command-line arguments, worker processes."""
