"""Pictures and pages of an estimate."""
