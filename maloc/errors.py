"""Errors and warnings that maloc raises, each with a mend where there is one."""

from __future__ import annotations

__all__ = ["FitError", "InputError", "MalocWarning"]


class MalocWarning(UserWarning):
    """Something the user should know about the input or the fit, but that stops nothing."""


class InputError(ValueError):
    """Bad input: says file, row, column, what is wrong and how to mend it, in one line.

    Parameters
    ----------
    problem : str
        What is wrong.
    file, row, column : optional
        Where: file name, line of the file (1 = first line), column name.
    mend : str, optional
        What the user can do about it.
    """

    def __init__(
        self,
        problem: str,
        *,
        file: object = None,
        row: int | None = None,
        column: str | None = None,
        mend: str | None = None,
    ) -> None:
        self.problem, self.file, self.row, self.column, self.mend = problem, file, row, column, mend
        where = [] if file is None else [str(file)]
        if row is not None:
            where.append(f"line {row}")
        if column is not None:
            where.append(f"column '{column}'")
        text = f"{', '.join(where)}: {problem}" if where else problem
        super().__init__(" ".join(f"{text}; {mend}".split()) if mend else " ".join(text.split()))


class FitError(RuntimeError):
    """A fit that failed and says why; never returned as if it were fine."""


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
