"""Journal: what a study has finished, so that nothing is lost however it ends."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

from sphtrunc.output import digest

Row = dict[str, Any]


class Journal:
    """Finished groups, one a line, appended and flushed to the disk as they come.

    A line that was cut short by a kill or by a full disk is dropped when the journal is opened.
    """

    def __init__(self, path: Path, settings: dict[str, Any]) -> None:
        self.path = path
        self.done: dict[int, list[Row]] = {}
        head = {
            "schema": "sphtrunc.study.journal/1",
            "digest": digest(settings),
            "settings": settings,
        }
        if not path.exists():
            self._file = self._open()
            self._write(head)
            return
        kept = self._read(head)
        self._file = self._open()
        try:
            self._file.truncate(kept)
            self._file.seek(kept)
        except OSError as error:
            raise self._failed(error) from None
        if not kept:
            self._write(head)

    def _read(self, head: dict[str, Any]) -> int:
        """Take up finished groups; the number of bytes that are whole."""
        data = self.path.read_bytes()
        kept = 0
        for number, line in enumerate(data.split(b"\n")[:-1]):
            try:
                entry = json.loads(line)
            except ValueError:
                break
            if number == 0:
                self._same(entry, head)
            else:
                self.done[int(entry["group"])] = entry["rows"]
            kept += len(line) + 1
        return kept

    def _same(self, found: Any, head: dict[str, Any]) -> None:
        if isinstance(found, dict) and found.get("digest") == head["digest"]:
            return
        old = found.get("settings", {}) if isinstance(found, dict) else {}
        new = head["settings"]
        names = [k for k in new if k != "axes" and old.get(k) != new[k]]
        names += [k for k in new["axes"] if old.get("axes", {}).get(k) != new["axes"][k]]
        raise ValueError(
            f"journal {self.path}: it belongs to other settings ({', '.join(names) or 'unknown'});"
            " repeat the command that began it, choose another output, or remove it"
        )

    def add(self, group: int, rows: list[Row]) -> None:
        """Keep a finished group."""
        self._write({"group": group, "rows": rows})
        self.done[group] = rows

    def _open(self) -> Any:
        try:
            return open(self.path, "r+b" if self.path.exists() else "x+b", buffering=0)
        except OSError as error:
            raise ValueError(
                f"journal {self.path}: {error.strerror or error}; expected an output in a folder"
                " that exists and may be written to"
            ) from None

    def _write(self, entry: dict[str, Any]) -> None:
        data = (json.dumps(entry, ensure_ascii=False) + "\n").encode()
        try:
            while data:
                data = data[self._file.write(data) :]
            os.fsync(self._file.fileno())
        except OSError as error:
            raise self._failed(error) from None

    def _failed(self, error: OSError) -> ValueError:
        return ValueError(
            f"journal {self.path}: {error.strerror or error}; the groups finished so far are kept,"
            " make room and repeat the command to continue"
        )

    def close(self) -> None:
        """Close the file; it stays."""
        self._file.close()
