// Lattices: integer points that repeat with a period along each axis, stretched by one unit per axis.

/** Offsets in h, [x, y, z], of all particles within the support of one of them, itself included. */
function neighbours(lattice, dxOverH, support) {
  const { dim, units, period, sites } = lattice;
  const step = units.map((unit) => unit * dxOverH);
  const axes = [0, 1, 2].map((axis) => {
    if (axis >= dim) return [0];
    const most = Math.ceil(support / (step[axis] * period[axis]));
    return Array.from({ length: 2 * most + 1 }, (_, n) => (n - most) * period[axis]);
  });
  const found = [];
  for (const i of axes[0])
    for (const j of axes[1])
      for (const k of axes[2]) {
        for (const site of sites) {
          const s = [i, j, k].map((cell, axis) =>
            axis < dim ? (cell + site[axis]) * step[axis] : 0,
          );
          if (Math.hypot(...s) <= support * (1 + 1e-12)) found.push(s.slice(0, dim));
        }
      }
  return found;
}
