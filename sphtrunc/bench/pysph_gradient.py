"""The standard gradient as an equation of PySPH, which reads it from this file and compiles it."""
# annotations would change what PySPH compiles: it reads the types off the names of the arguments

from pysph.sph.equation import Equation


class Gradient(Equation):
    """g_a = Σ_b V_b A_b ∇_a W(x_a − x_b)."""

    def initialize(self, d_idx, d_gx, d_gy, d_gz):
        d_gx[d_idx] = 0.0
        d_gy[d_idx] = 0.0
        d_gz[d_idx] = 0.0

    def loop(self, d_idx, s_idx, d_gx, d_gy, d_gz, s_V, s_A, DWIJ):
        d_gx[d_idx] += s_V[s_idx] * s_A[s_idx] * DWIJ[0]
        d_gy[d_idx] += s_V[s_idx] * s_A[s_idx] * DWIJ[1]
        d_gz[d_idx] += s_V[s_idx] * s_A[s_idx] * DWIJ[2]
