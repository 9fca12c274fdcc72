"""What is refused where an optional dependency is missing."""

from __future__ import annotations

from maloc.errors import InputError

__all__ = ["needs"]


def needs(
    what: str,
    package: str,
    extra: str,
    problem: ImportError,
    *,
    file: object = None,
    otherwise: str = "",
) -> InputError:
    """Return the error of something that needs a package which cannot be imported.

    Parameters
    ----------
    what, package : str
        What was asked for, and what it needs.
    extra : str
        The extra of maloc that brings the package.
    problem : ImportError
        Why it cannot be imported; said where the package is there but broken.
    file : optional
        The file that was to be read or written.
    otherwise : str
        What can be done instead.
    """
    broken = "" if isinstance(problem, ModuleNotFoundError) else f", which fails ({problem})"
    mend = f'pip install "maloc[{extra}]"' + (f", or {otherwise}" if otherwise else "")
    return InputError(f"{what} needs {package}{broken}", file=file, mend=mend)
