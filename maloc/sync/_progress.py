"""How a synchronisation says how far it is."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

__all__ = ["Tell", "progress_bar", "silent"]

Tell = Callable[[str], None]  # called at each step with the name of the stage
PATIENCE = 1.0  # s; what ends sooner shows no bar


def silent(stage: str) -> None:
    """Say nothing."""


@contextmanager
def progress_bar(show: bool) -> Iterator[Tell]:
    """Count steps on stderr, under the name of their stage; how many there will be is not known."""
    from tqdm import tqdm

    with tqdm(unit="step", disable=not show, leave=False, delay=PATIENCE) as bar:

        def tell(stage: str) -> None:
            bar.set_description_str(f"sync, {stage}", refresh=False)
            bar.update()

        yield tell
