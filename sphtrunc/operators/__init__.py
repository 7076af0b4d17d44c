"""Operators: what an SPH sum stands for, as algebra on discrete moments.

`terms` is the one table of what is summed; `corrections` (Shepard, CSPH, RKPM) are the same
functions for fractions, symbols and arrays; `Moments` is what theory and experiment both return.
The rule: ⟨D A⟩ = Σ_α (h^{|α|−k}/α!) M_α A^{(α)}, so the moments are the truncation error.
"""
