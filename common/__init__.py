"""Shared conduct of commands: errors, files, words of the command line, worker processes."""
