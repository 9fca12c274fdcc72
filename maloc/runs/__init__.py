"""What a command does, from files to a finished folder."""

__all__: list[str] = []
