"""Readers: one file a format, found by the header."""
