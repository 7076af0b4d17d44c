"""Bench: run time against error, on the machine at hand.

`suites` runs them; `accuracy` and `stability` hold theirs; `report` and `pictures` show what was
found.
"""

from sphtrunc.bench.suites import SUITES, bench

__all__ = ["SUITES", "bench"]
