"""Text files, read with an error that says which file it was and what it was for."""

from __future__ import annotations

from pathlib import Path

from station.errors import InvalidFile


def read_text(path: Path, what: str, hint: str = "") -> str:
    """A text file's content; raises InvalidFile, with the hint, if it's missing, and if it's no text."""
    try:
        return path.read_text(encoding="utf-8")
    except FileNotFoundError as error:
        raise InvalidFile(f"no {what} '{path}'" + (f"; {hint}" if hint else "")) from error
    except (OSError, UnicodeDecodeError) as error:
        raise InvalidFile(f"can't read {what} '{path}': {error}") from error
