"""The canal study."""

__all__: list[str] = []
