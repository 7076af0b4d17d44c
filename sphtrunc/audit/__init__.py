"""Audit: somebody else's kernel beside the exact one.

`inspection` judges; `signatures`, `samples` and `tables` bring the values, `recognition` and
`reconstruction` say which kernel they are, `scaling` how they depend on h. What may be wrong is in
`explanations` (with its `slips`), `shapes` and `slopes`, in the words of `faults`. `identification`
knows whose constant a number is, `constants` reads one, `golden` writes reference values for other
codes, and `codes` compares the kernels of all sums of one. `published.toml` lists published
formulas.
"""

from sphtrunc.audit.inspection import PUBLISHED, audit, audit_formula, audit_list, audit_table
from sphtrunc.audit.report import MARKDOWN_HEAD, Audit

__all__ = [
    "MARKDOWN_HEAD",
    "PUBLISHED",
    "Audit",
    "audit",
    "audit_formula",
    "audit_list",
    "audit_table",
]
