"""Bench: run time against error, on the machine at hand.

`suites` runs what `speed` (with `peers` to race against), `accuracy` and `stability` hold; `report`
and `pictures` show what was found.
"""

from sphtrunc.bench.suites import SUITES, bench

__all__ = ["SUITES", "bench"]
