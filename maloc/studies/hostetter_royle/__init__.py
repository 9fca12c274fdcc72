"""The study of Hostetter & Royle (2020) again."""

__all__: list[str] = []
