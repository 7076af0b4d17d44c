"""Audit: somebody else's kernel beside the exact one.

`inspection` judges, with what `recognition` identifies, `reconstruction` fits and `faults` knows of
slips; `samples` reads callables and tables; `published.toml` lists published formulas.
"""

from sphtrunc.audit.inspection import (
    MARKDOWN_HEAD,
    PUBLISHED,
    Audit,
    audit,
    audit_formula,
    audit_list,
    audit_table,
)

__all__ = [
    "MARKDOWN_HEAD",
    "PUBLISHED",
    "Audit",
    "audit",
    "audit_formula",
    "audit_list",
    "audit_table",
]
