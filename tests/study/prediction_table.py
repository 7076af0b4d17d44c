"""Predicted against measured errors for many settings drawn at random: as the test of the same name
does for a few, on demand.

    python tests/study/prediction_table.py --first 0 --count 2000 -o found.csv

Of every 20 settings 12 are in 1D, 6 in 2D and 2 in 3D. A row each: number, dimension, what it is,
measured over predicted, half of the 95 % interval, what the prediction says it is good to, and
whether it lies near (within 5 % or the interval), within what it says, or off. Rows that the file
has already are not drawn again. An hour on one core.
"""

from __future__ import annotations

import argparse
import csv
from collections import Counter
from pathlib import Path

from test_predictions import TARGETS, compared, setting

FIELDS = ["number", "dim", "what", "ratio", "interval", "uncertainty", "verdict"]


def dimension(number: int) -> int:
    """Of a setting: 1D is the cheapest."""
    return {0: 3, 10: 3}.get(number % 20, 2 if number % 3 == 1 else 1)


def described(name, operator, scene, field) -> str:
    base = scene.lattice
    offset = "" if not any(base.offset) else f" offset {','.join(map(str, base.offset))}"
    return (
        f"{name} {operator.name} {operator.form} {operator.correction} {base.kind}"
        f" {base.dx_over_h}{offset} {scene.volume} {scene.distribution} {scene.sigma}"
        f" h/λ {field.h_over_lambda}"
    )


def row(number: int) -> dict[str, object]:
    """One setting."""
    dim = dimension(number)
    drawn = setting(number, dim)
    found: dict[str, object] = {"number": number, "dim": dim, "what": described(*drawn)}
    try:
        ratio, interval, uncertainty = compared(*drawn, TARGETS[dim])
    except ValueError as reason:
        return {**found, "verdict": f"refused: {reason}"}
    away = abs(ratio - 1)
    near = away <= max(0.05, interval)
    said = away <= uncertainty + interval
    verdict = "near" if near else "as it says" if said else "off"
    figures = {"ratio": ratio, "interval": interval, "uncertainty": uncertainty}
    return {**found, **{k: f"{v:.4f}" for k, v in figures.items()}, "verdict": verdict}


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--count", type=int, default=2000)
    parser.add_argument("-o", "--output", type=Path, default=Path("predictions.csv"))
    options = parser.parse_args()
    before = []
    if options.output.exists():
        with options.output.open(newline="") as file:
            before = list(csv.DictReader(file))
    known = {int(one["number"]) for one in before}
    verdicts = Counter(one["verdict"].split(":")[0] for one in before)
    with options.output.open("a", newline="") as file:
        table = csv.DictWriter(file, FIELDS)
        if not before:
            table.writeheader()
        for number in range(options.first, options.first + options.count):
            if number in known:
                continue
            found = row(number)
            table.writerow(found)
            file.flush()
            verdicts[str(found["verdict"]).split(":")[0]] += 1
    print(dict(verdicts))


if __name__ == "__main__":
    main()
