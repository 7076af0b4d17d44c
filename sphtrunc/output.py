"""Where results go: to the terminal, or whole into a file."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from textwrap import wrap
from typing import IO, Any


def write_atomically(path: str | Path, text: str | bytes) -> None:
    """Write the file so that a reader sees the old content or the new, never a part of it.

    Raises ValueError, naming the file and the reason, where that is not possible.
    """
    with replacing(path) as file:
        file.write(text.encode() if isinstance(text, str) else text)


@contextmanager
def replacing(path: str | Path) -> Iterator[IO[bytes]]:
    """A file to write to, which takes the place of `path` once it is whole; for what is too large
    for `write_atomically`. Raises ValueError as that does."""
    import tempfile

    target = Path(path)
    if not target.name:
        raise ValueError(f"output: got {str(path)!r}, expected the name of a file")
    temporary: str | None = None
    try:
        handle, temporary = tempfile.mkstemp(dir=target.parent, prefix=f".{target.name}.")
        with os.fdopen(handle, "w+b") as file:
            yield file
            file.flush()
            os.fsync(file.fileno())
        mask = os.umask(0)
        os.umask(mask)
        os.chmod(temporary, 0o666 & ~mask)
        os.replace(temporary, target)
        temporary = None
    except OSError as error:
        raise ValueError(f"output {target}: {error.strerror or error}") from None
    finally:
        if temporary is not None:
            Path(temporary).unlink(missing_ok=True)


def digest(settings: dict[str, Any]) -> str:
    """A fingerprint of everything that a result depends on, 64 digits."""
    import hashlib
    import json

    text = json.dumps(settings, sort_keys=True, ensure_ascii=False)
    return hashlib.sha256(text.encode()).hexdigest()


def wrapped(sentences: Iterable[str]) -> list[str]:
    """Sentences as lines of a terminal, what follows the first of each set in."""
    return [line for text in sentences for line in wrap(text, 100, subsequent_indent="  ")]


def emit(text: str, path: str | Path | None) -> None:
    """Print the text, or write it to the file if there is one.

    Raises ValueError where it cannot be written.
    """
    if path is None:
        try:
            print(text, flush=True)
        except BrokenPipeError:
            raise
        except OSError as error:  # a full disk: what is left in the buffer goes nowhere
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            raise ValueError(f"output: {error.strerror or error}") from None
    else:
        write_atomically(path, text if text.endswith("\n") else text + "\n")
