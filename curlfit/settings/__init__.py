"""Choices of a verb: one dataclass each, from which flags, settings and
keywords are made."""
