"""What the package knows of itself: its version, versions it was run with, names that moved.

Nothing comes in but maloc's errors; out go the version, a warning, the module at its new place.
Start at `version`. There is no mathematics.
"""
