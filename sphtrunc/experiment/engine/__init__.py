"""Engine: every sum that operators need over the pairs of explicit particles, in one pass.

`pairs` holds the pair formula, `bounds` that of its rounding, `sources` what they are applied to;
`cells`, with `lanes`, runs it compiled and `tree` on NumPy arrays; `passes` and `groups` are what
the rest of the package calls.
"""

from sphtrunc.experiment.engine.groups import Grouped, grouped, sizes
from sphtrunc.experiment.engine.passes import (
    PairSums,
    Pass,
    Work,
    available,
    one_pass,
    pair_sums,
    pairs_with_terms,
    prepared,
    threads,
)
from sphtrunc.experiment.engine.sources import volumes

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
