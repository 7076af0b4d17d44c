"""Codes: whether all sums of one code take the same kernel.

Each may be right by itself, and together they are not: LAMMPS sums its densities with (1 − q²)⁴ and
takes its forces from the gradient of Lucy's kernel, so that what it conserves is no energy of its
densities.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from math import isclose

from sphtrunc.audit import faults
from sphtrunc.audit.faults import Fault
from sphtrunc.audit.report import Audit

_ROUNDING = 1e-6  # of a support that was seen in samples


def across(reports: Sequence[tuple[Audit, str, str]]) -> list[Audit]:
    """The reports, each of (report, code, operator), with a fault where another operator of the
    same code in the same dimension takes another kernel or another support.

    operator: what the kernel is for, "density" or "pressure force"; "" is compared with nothing
    """
    first: dict[tuple[str, int], tuple[Audit, str]] = {}
    found = []
    for report, code, operator in reports:
        if operator:
            known, its = first.setdefault((code, report.dim), (report, operator))
            if not _alike(report, known):
                told = (
                    f"{operator} takes {_shown(report)}, and {its} of the same code {_shown(known)}"
                )
                fault = Fault(faults.MIXED, told, "both as recognised above")
                report = replace(report, faults=(*report.faults, fault))
        found.append(report)
    return found


def _alike(one: Audit, other: Audit) -> bool:
    return _shape(one) == _shape(other) and isclose(one.support, other.support, rel_tol=_ROUNDING)


def _shape(report: Audit) -> str:
    known = report.kernel not in ("", "reconstructed")
    return report.kernel if known else report.shape


def _shown(report: Audit) -> str:
    name = report.kernel or "a kernel that was not recognised"
    return f"{name} with support {report.support:.7g} h"
