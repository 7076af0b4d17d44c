"""What was found about a kernel, as data, text, JSON and a row of a table."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from typing import Any

from sphtrunc.audit.faults import Fault
from sphtrunc.version import __version__

SCHEMA = "sphtrunc.audit/2"
MARKDOWN_HEAD = (
    "| subject | dim | kernel | support | integral | finding |\n|---|---|---|---|---|---|"
)


@dataclass(frozen=True)
class Audit:
    """What was found about a kernel in one dimension. All exact numbers are strings.

    kernel: its name in the catalogue, "reconstructed", or "" where no exact form was recognised
    signature: how a callable was called; scaling: the powers of h, as far as they could be seen
    integral: ∫ W d^d r; constant: the σ_d that the shape, as written here, should have
    convention: what the smoothing length is; continuity: derivatives continuous at each knot
    inflection: where the curvature changes sign, q as a fraction or a decimal
    """

    subject: str
    dim: int
    signature: str
    kernel: str
    shape: str
    support: float
    convention: str
    integral: str
    constant: str
    boundary_smoothness: int | None
    smoothness: float | None
    continuity: dict[str, str]
    positive: bool
    monotonic: bool
    inflection: tuple[str, ...]
    second_moment: str
    derivative: str
    second_derivative: str
    scaling: str
    faults: tuple[Fault, ...]
    notes: tuple[str, ...]

    @property
    def clean(self) -> bool:
        """Whether there are no faults."""
        return not self.faults

    def to_dict(self) -> dict[str, Any]:
        """The fields, with schema and version."""
        return {"schema": SCHEMA, **asdict(self), "clean": self.clean, "version": __version__}

    def to_json(self) -> str:
        """The same as JSON."""
        return json.dumps(self.to_dict(), indent=2, ensure_ascii=False)

    def to_text(self) -> str:
        """A line for each thing that was found, faults last."""
        second = "" if self.second_derivative == "not given" else self.second_derivative
        rows = [
            ("called as", self.signature),
            ("kernel", self.kernel or "no exact form recognised"),
            ("shape", self.shape),
            ("support", f"{self.support:.9g} h"),
            ("h is", self.convention),
            ("integral", self.integral),
            ("constant", self.constant),
            ("dW/dr", self.derivative),
            ("d²W/dr²", second),
            ("scaling", self.scaling),
            ("β", "" if self.boundary_smoothness is None else str(self.boundary_smoothness)),
            ("continuity", ", ".join(f"{k}: {v}" for k, v in self.continuity.items())),
            ("signs", self._signs()),
            ("∫r²W", self.second_moment),
        ]
        verdict = "clean" if self.clean else f"{len(self.faults)} fault(s)"
        lines = [f"{self.subject}, {self.dim}D: {verdict}"]
        lines += [f"  {name:<11}{said}" for name, said in rows if said]
        for fault in self.faults:
            lines.append(f"  FAULT      {fault.kind}: {fault.message}")
            lines += [f"  evidence   {fault.surely}"] if fault.surely else []
            lines += [f"             or {other}" for other in fault.also]
        lines += [f"  note       {note}" for note in self.notes]
        return "\n".join(lines)

    def to_markdown(self) -> str:
        """One row of the table whose head is `MARKDOWN_HEAD`."""
        said = "; ".join(f"**{f.kind}**: {f.message}" for f in self.faults) or "clean"
        cells = [
            self.subject,
            str(self.dim),
            self.kernel or "–",
            f"{self.support:.7g} h",
            self.integral,
            said,
        ]
        return "| " + " | ".join(c.replace("|", "\\|") for c in cells) + " |"

    def _signs(self) -> str:
        parts = [
            "positive" if self.positive else "changes sign",
            "falls monotonically" if self.monotonic else "does not fall monotonically",
        ]
        if self.inflection:
            parts.append("inflection at q = " + ", ".join(self.inflection))
        return ", ".join(parts)
