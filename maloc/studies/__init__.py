"""Published simulation studies, repeated."""

__all__: list[str] = []
