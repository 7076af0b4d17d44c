"""Engine: every sum that operators need over the pairs of explicit particles, in one pass.

`pairs` holds the pair formula and `radial` its factors; `cells`, with `lanes`, runs it compiled and
`neighbours` on NumPy arrays; `passes` is what the rest of the package calls.
"""

from sphtrunc.experiment.engine.passes import (
    Grouped,
    PairSums,
    Pass,
    Work,
    available,
    grouped,
    one_pass,
    pair_sums,
    pairs_with_terms,
    prepared,
    sizes,
    threads,
    volumes,
)

__all__ = [
    "Grouped",
    "PairSums",
    "Pass",
    "Work",
    "available",
    "grouped",
    "one_pass",
    "pair_sums",
    "pairs_with_terms",
    "prepared",
    "sizes",
    "threads",
    "volumes",
]
