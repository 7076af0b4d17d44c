"""Hypothesis profiles: `ci` is repeatable, `deep` looks further (HYPOTHESIS_PROFILE=deep)."""

import hashlib
import os
from pathlib import Path

from hypothesis import HealthCheck, settings

settings.register_profile(
    "ci",
    derandomize=True,
    deadline=None,
    print_blob=True,
    suppress_health_check=[HealthCheck.too_slow],
)
settings.register_profile(
    "deep", parent=settings.get_profile("ci"), derandomize=False, max_examples=20_000
)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "ci"))

# Numba keeps a compiled loop for as long as its own file is the same, whatever becomes of the
# formulas that it was compiled from: here they have a folder of their own for each state of them.
_ROOT = Path(__file__).parents[1] / "sphtrunc"
_STATE = hashlib.sha256(
    b"".join(
        path.read_bytes()
        for folder in ("arithmetic", "kernels", "operators", "experiment/engine")
        for path in sorted((_ROOT / folder).glob("*.py"))
    )
).hexdigest()[:12]
os.environ["SPHTRUNC_CACHE"] = ""  # a glass of another state of the code is none of a test's
os.environ.setdefault("NUMBA_CACHE_DIR", str(Path(__file__).parent / "__pycache__" / _STATE))
