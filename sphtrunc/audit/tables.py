"""A table of somebody's kernel: CSV or NPZ with q (or r and h), W and its derivatives."""

from __future__ import annotations

import csv
import io
import math
from pathlib import Path

import numpy as np

from sphtrunc.audit.samples import DOUBLE, SINGLE, Array, Samples, Scaled, said

MAX_FILE = 1 << 24  # bytes of a table
LEAST_POINTS = 16
SINGLE_DIGITS = 5e-11  # half a unit of the tenth digit: single precision is written with nine

#: column: the names it goes by, in lower case
NAMES: dict[str, tuple[str, ...]] = {
    "q": ("q", "r/h", "u"),
    "r": ("r", "rij", "distance", "dist"),
    "h": ("h", "hsml", "smoothing_length"),
    "w": ("w", "kernel", "w(r,h)", "w(q)"),
    "dw": ("dw", "dw/dr", "dwdr", "dw_dr", "dw/dq", "dwdq", "w'", "gradw"),
    "d2w": ("d2w", "d2w/dr2", "d2wdr2", "d2w_dr2", "d2w/dq2", "d2wdq2", "w''"),
}
_MEANING = {name: meaning for meaning, names in NAMES.items() for name in names}

Column = tuple[Array, Array]  # values, and what their decimals leave open


def from_table(path: str | Path, dim: int) -> Samples:
    """A table: CSV with a header, or NPZ, with columns q (or r and h), W and optionally dW, d2W.

    dW is dW/dr, unless its column is called dW/dq. Rows of several h are taken apart: those of the
    h with most rows are the kernel, the others show how it depends on h. Decimals are taken to be
    rounded at their last digit. NPZ files are read without pickle. Columns of other names are left
    alone, and a note says so.

    Raises ValueError, naming the file, where columns are missing, doubled, unsorted or too short.
    """
    file = Path(path)
    raw = _read_npz(file) if file.suffix.lower() == ".npz" else _read_csv(file)
    columns, ignored, by_q = _meant(raw, file)
    q, blur = _distances(columns, file)
    if len(q) < LEAST_POINTS:
        raise ValueError(f"table {file}: {len(q)} points, expected at least {LEAST_POINTS}")
    for name, (values, _) in columns.items():
        if values.shape != q.shape or values.ndim != 1:
            raise ValueError(f"table {file}: column {name!r} is of shape {values.shape}")
        if not np.isfinite(values).all():
            raise ValueError(f"table {file}: column {name!r} holds NaN or infinity")
    h = columns["h"][0] if "h" in columns else np.ones_like(q)
    groups = [
        _group(columns, q, blur, h == one, float(one), dim, by_q, file) for one in np.unique(h)
    ]
    if not any(np.any(group.w) for group in groups):
        raise ValueError(
            f"table {file}: W is zero everywhere; is a constant such as 2/3 an integer division"
            " there, which gives 0?"
        )
    base = max(groups, key=lambda g: (len(g.q), -abs(math.log(g.h))))
    if len(base.q) < LEAST_POINTS:
        raise ValueError(
            f"table {file}: at most {len(base.q)} points have the same h, expected at least"
            f" {LEAST_POINTS}"
        )
    inside = np.nonzero(base.w)[0]
    if not len(inside):
        raise ValueError(f"table {file}: W is zero everywhere at h = {base.h:g}")
    last = int(inside[-1])
    end = float(base.q[last + 1]) if last + 1 < len(base.q) else math.inf
    # written from single precision: exactly its values, or no more digits than it has
    some = base.w != 0
    raw_w = columns["w"][0]
    single = bool(np.all(raw_w.astype(np.float32) == raw_w)) or bool(
        np.median(base.error[some] / np.abs(base.w[some])) > SINGLE_DIGITS
    )
    unit = SINGLE if single else DOUBLE
    notes = [f"columns of no known meaning, left alone: {', '.join(ignored)}"] if ignored else []
    return Samples(
        q=base.q,
        w=base.w,
        dw=base.dw,
        d2w=base.d2w,
        unit=unit,
        error=base.error,
        derivative_error=base.derivative_error,
        second_error=base.second_error,
        support=(float(base.q[last]), end),
        declared=unit,
        function=None,
        h=base.h if "h" in columns else None,
        scaled=(base, *(group for group in groups if group is not base)),
        notes=tuple(notes),
    )


def _meant(raw: dict[str, Column], file: Path) -> tuple[dict[str, Column], list[str], set[str]]:
    """The columns by their meaning, the names of those that have none, the derivatives by q."""
    columns: dict[str, Column] = {}
    ignored, by_q = [], set()
    for name, column in raw.items():
        meaning = _MEANING.get(name.replace(" ", ""))
        if meaning is None:
            ignored.append(name)
        elif meaning in columns:
            raise ValueError(f"table {file}: two columns for {meaning}, expected one")
        else:
            columns[meaning] = column
            by_q |= {meaning} if "dq" in name else set()
    if "w" not in columns:
        raise ValueError(f"table {file}: no column W among {sorted(raw)}")
    return columns, ignored, by_q


def _distances(columns: dict[str, Column], file: Path) -> Column:
    if "h" in columns and not np.all(columns["h"][0] > 0):
        raise ValueError(f"table {file}: h must be positive")
    if "q" in columns:
        return columns["q"]
    if "r" in columns and "h" in columns:
        h = columns["h"][0]
        if h.shape != columns["r"][0].shape:
            raise ValueError(f"table {file}: r and h are of different length")
        return columns["r"][0] / h, columns["r"][1] / h
    raise ValueError(f"table {file}: no column q, nor r and h, among {sorted(columns)}")


def _group(
    columns: dict[str, Column],
    q: Array,
    blur: Array,
    rows: Array,
    h: float,
    dim: int,
    by_q: set[str],
    file: Path,
) -> Scaled:
    """The rows of one h: h^d W and so on, with the errors of their digits and of q's."""
    q, blur, numbers = q[rows], blur[rows], np.nonzero(rows)[0]
    falls = np.nonzero(np.diff(q) <= 0)[0]
    if q[0] < 0 or len(falls):
        at = 0 if q[0] < 0 else int(falls[0]) + 1
        what = "repeats" if at and q[at] == q[at - 1] else "falls" if at else "starts below zero"
        of = f" of h = {h:g}" if "h" in columns else ""
        raise ValueError(
            f"table {file}: q {what} at point {numbers[at] + 1}{of}, expected increasing distances"
        )
    found: list[Column | None] = []
    for order, name in enumerate(("w", "dw", "d2w")):
        if name not in columns:
            found.append(None)
            continue
        power = dim + (order if name not in by_q else 0)  # d/dq is h d/dr
        values, error = (part[rows] * h**power for part in columns[name])
        if blur.any() and len(q) > 2:
            slope = np.abs(np.gradient(values, q))
            error = error + blur * (slope if order == 0 else np.max(slope)) + blur**2
        found.append((values, error))
    (w, error), first, second = found[0] or (q, q), found[1], found[2]
    none = np.zeros_like(q)
    return Scaled(
        h=h,
        q=q,
        w=w,
        dw=first and first[0],
        d2w=second and second[0],
        error=error,
        derivative_error=first[1] if first else none,
        second_error=second[1] if second else none,
    )


def _read_npz(file: Path) -> dict[str, tuple[Array, Array]]:
    _readable(file)
    try:
        with np.load(file, allow_pickle=False) as archive:
            found = {str(name).strip().lower(): archive[name] for name in archive.files}
    except Exception as error:
        raise ValueError(f"table {file}: not a readable NPZ file: {said(error)}") from None
    for name, values in found.items():
        if values.dtype.kind not in "iuf":
            raise ValueError(f"table {file}: column {name!r} is of type {values.dtype}")
    return {
        name: (v.astype(np.float64), np.zeros(v.shape, dtype=np.float64))
        for name, v in found.items()
    }


def _read_csv(file: Path) -> dict[str, tuple[Array, Array]]:
    _readable(file)
    try:
        rows = [r for r in csv.reader(io.StringIO(file.read_text(encoding="utf-8"))) if r]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise ValueError(f"table {file}: {said(error)}") from None
    if not rows:
        raise ValueError(f"table {file}: empty")
    header = [name.strip().lstrip("#").strip().lower() for name in rows[0]]
    if len(set(header)) != len(header):
        raise ValueError(f"table {file}: column {header[0]!r} or another appears twice")
    texts: dict[str, list[str]] = {name: [] for name in header}
    for number, row in enumerate(rows[1:], start=2):
        if len(row) != len(header):
            raise ValueError(
                f"table {file}: line {number} has {len(row)} columns, not {len(header)}"
            )
        for name, text in zip(header, row, strict=True):
            try:
                float(text)
            except ValueError:
                raise ValueError(
                    f"table {file}: line {number}, column {name!r}: {text[:20]!r} is not a number"
                ) from None
            texts[name].append(text)
    return {name: _decimals(column) for name, column in texts.items()}


def _decimals(texts: list[str]) -> Column:
    """The numbers, and half a unit of the last digit of each; 0 where they have all of a double's.

    A short one such as 0.5 has as many significant digits, and decimals, as the rest of its column.
    """
    written = [text.strip().lower().partition("e") for text in texts]
    significant = [len(m.lstrip("+-").replace(".", "").lstrip("0")) for m, _, _ in written]
    decimals = [len(m.partition(".")[2]) - int(e or 0) for m, _, e in written]
    values = np.array([float(text) for text in texts])
    if not texts or max(significant) >= 15:
        # a column with all the digits of doubles somewhere has them everywhere: 0.25 is then exact
        return values, np.zeros(len(texts))
    finest = 0.5 * 10.0 ** -max(decimals)
    with np.errstate(divide="ignore"):
        leading = np.floor(np.log10(np.abs(values)))
    relative = 0.5 * 10.0 ** (np.where(values == 0, -300.0, leading) - max(significant) + 1)
    own = 0.5 * 10.0 ** -np.array(decimals, dtype=float)
    return values, np.minimum(own, np.maximum(finest, relative))


def _readable(file: Path) -> None:
    if not file.is_file():
        raise ValueError(f"table {file}: no such file")
    if file.stat().st_size > MAX_FILE:
        raise ValueError(f"table {file}: larger than {MAX_FILE} bytes")
